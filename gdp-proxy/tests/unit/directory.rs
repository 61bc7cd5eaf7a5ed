//! What the members of a domain share, as it adds to the configuration.

use gdp_core::card::NameCard;
use gdp_core::cert::{Enrollment, Grantee, MemberCert, ReadGrant, RenewalDelegation, TopicsOf, issue};
use gdp_core::identity::{Identity, SigningKey};

use super::*;
use crate::config::{Thing, What};

fn member(label: &str, expose: &[&str], import: &[&str], read: &[(&str, &str)]) -> Member {
    let (entity, owner) = (Identity::generate("proxy").unwrap().name(), SigningKey::generate().unwrap());
    let card = NameCard::create(owner.verify_key(), "catalog", label, "", None).unwrap();
    let (name, to) = (card.name(), Grantee::Entity(entity));
    let grant = issue(&owner, &ReadGrant { name, to, serial: 1, not_before: 0, not_after: u64::MAX }).unwrap();
    let texts = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>();
    let rule = |member: &str, topics| TopicsOf { member: member.to_owned(), topics };
    let import = if import.is_empty() { vec![] } else { vec![rule("server", texts(import))] };
    let enrollment = Enrollment {
        domain: name,
        member: 1,
        label: label.into(),
        expose: texts(expose),
        import,
        read: read.iter().map(|(label, pattern)| rule(label, texts(&[pattern]))).collect(),
        join_service: owner.verify_key(),
        serial: 1,
        not_before: 0,
        not_after: u64::MAX,
    };
    Member { entity, enrollment, catalog: Some(card), grant: Some(grant.into()) }
}

fn topic(text: &str) -> TopicName {
    TopicName::parse(text).unwrap()
}

#[test]
fn a_server_imports_under_labels_and_exposes_what_members_import() {
    let members = [
        member("robot7", &["/camera/**"], &["/cmd_vel"], &[]),
        member("server", &[], &[], &[("*", "/**")]),
        member("robot8", &["/chatter"], &[], &[]),
    ];
    let shared = shared(&members, members[1].entity, None);
    let labels: Vec<_> = shared.imports.iter().map(|(config, _)| config.prefix.as_ref().unwrap().as_str()).collect();
    assert_eq!(labels, ["/robot7", "/robot8"]);
    let (import, _) = &shared.imports[0];
    assert!(import.wants(Thing::Topic, &topic("/camera/image")));
    assert!(!import.wants(Thing::Topic, &topic("/secret")), "the domain lets robot7 expose its camera only");
    assert_eq!(import.local_name(Thing::Topic, &topic("/camera/image")), Some(topic("/robot7/camera/image")));
    assert_eq!(shared.exposed.exports, PatternsByKind::of(["/robot7/cmd_vel"]));
    assert_eq!(shared.exposed.readers.len(), 1, "nobody else reads of the server");
    assert_eq!(shared.exposed.readers[0].entity, members[0].entity);
}

#[test]
fn a_robot_imports_under_its_own_names_and_lets_the_server_read() {
    let members = [
        member("robot7", &["/camera/**"], &["/cmd_vel", "/nav/*/goal"], &[]),
        member("server", &[], &[], &[("*", "/**")]),
    ];
    let shared = shared(&members, members[0].entity, None);
    let [(import, _)] = &shared.imports[..] else { panic!() };
    for (there, here) in [("/robot7/cmd_vel", "/cmd_vel"), ("/robot7/nav/a/goal", "/nav/a/goal")] {
        assert!(import.wants(Thing::Topic, &topic(there)), "{there}");
        assert_eq!(import.local_name(Thing::Topic, &topic(there)), Some(topic(here)));
    }
    assert!(!import.wants(Thing::Topic, &topic("/robot8/cmd_vel")));
    assert_eq!(shared.exposed.readers[0].names, PatternsByKind::of(["/**"]));
}

#[test]
fn a_laptop_reads_one_robot_and_nobody_reads_the_laptop() {
    let members = [
        member("alice", &[], &[], &[("robot7", "/camera/**")]),
        member("robot7", &["/camera/**", "/chatter"], &[], &[]),
        member("robot8", &["/camera/**"], &[], &[]),
    ];
    let shared_with_alice = shared(&members, members[0].entity, None);
    let [(import, _)] = &shared_with_alice.imports[..] else { panic!() };
    assert!(import.wants(Thing::Topic, &topic("/camera/image")) && !import.wants(Thing::Topic, &topic("/chatter")));
    assert!(shared_with_alice.exposed.readers.is_empty());
    let of_robot7 = shared(&members, members[1].entity, None);
    assert_eq!(of_robot7.exposed.readers[0].names, PatternsByKind::of(["/camera/**"]));
    let of_robot8 = shared(&members, members[2].entity, None);
    assert!(of_robot8.exposed.readers.is_empty() && of_robot8.imports.is_empty());
}

#[test]
fn who_is_not_in_the_directory_shares_nothing() {
    let members = [member("robot7", &["/**"], &[], &[("*", "/**")]), member("server", &[], &[], &[("*", "/**")])];
    let stranger = Identity::generate("proxy").unwrap().name();
    let shared = shared(&members, stranger, None);
    assert!(shared.imports.is_empty() && shared.exposed.readers.is_empty() && shared.exposed.exports.is_empty());
}

#[test]
fn services_and_actions_are_shared_as_such() {
    let members = [
        member("robot7", &["/chatter", "service:/plan", "action:/dock"], &["service:/map"], &[]),
        member("server", &[], &[], &[("*", "/**"), ("*", "service:/**")]),
    ];
    let (service, action) = (Thing::Call(What::Service), Thing::Call(What::Action));
    let at_server = shared(&members, members[1].entity, None);
    let (import, _) = &at_server.imports[0];
    assert!(import.wants(service, &topic("/plan")) && !import.wants(Thing::Topic, &topic("/plan")));
    assert!(!import.wants(action, &topic("/dock")), "the server may not call actions");
    assert_eq!(import.local_name(service, &topic("/plan")), Some(topic("/robot7/plan")));
    assert!(at_server.exposed.exports.covers(service, &topic("/robot7/map")));

    let at_robot = shared(&members, members[0].entity, None);
    let (import, _) = &at_robot.imports[0];
    assert!(import.wants(service, &topic("/robot7/map")));
    assert_eq!(import.local_name(service, &topic("/robot7/map")), Some(topic("/map")));
    let reader = &at_robot.exposed.readers[0].names;
    assert!(reader.covers(service, &topic("/plan")) && !reader.covers(action, &topic("/dock")));
}

#[test]
fn a_membership_is_replaced_by_its_renewal_and_by_one_of_the_domain_itself() {
    const NANOS: u64 = 1_000_000_000;
    let (domain, service) = (Identity::generate("domain").unwrap(), SigningKey::generate().unwrap());
    let (entity, now) = (Identity::generate("proxy").unwrap().name(), unix_seconds());
    let member = |role: &str, serial| {
        let claims = MemberCert {
            domain: domain.name(),
            entity,
            role: role.into(),
            serial,
            not_before: now - 60,
            not_after: now + 60,
        };
        Membership::issue(&domain, &claims).unwrap()
    };
    let first = member("robot", now * NANOS);
    let terms = RenewalDelegation {
        domain: domain.name(),
        member: now * NANOS,
        key: service.verify_key(),
        lifetime: 600,
        serial: now * NANOS,
        not_before: now - 60,
        not_after: now + 6000,
    };
    let renewed = first.renew(&service, &issue(domain.key(), &terms).unwrap(), now * NANOS + 1).unwrap();
    let exchanged = member("robot", now * NANOS + 2);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("membership");
    let stored = || Membership::from_pem(&std::fs::read_to_string(&file).unwrap()).unwrap();
    secret_file::replace(&file, first.to_pem().as_bytes()).unwrap();
    for (shown, expected) in [
        (&first, &first),
        (&renewed, &renewed),
        (&first, &renewed),
        (&member("applicant", now * NANOS + 9), &renewed),
        (&exchanged, &exchanged),
        (&renewed, &exchanged),
    ] {
        store_newer(shown, &file).unwrap();
        assert_eq!(stored(), *expected);
    }
    // A file that a person damaged stays as it is.
    std::fs::write(&file, "nonsense").unwrap();
    assert!(store_newer(&exchanged, &file).is_err());
}
