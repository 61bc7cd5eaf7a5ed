//! What the members of a domain share, as it adds to the configuration.

use gdp_core::card::NameCard;
use gdp_core::cert::{Enrollment, Grantee, ReadGrant, TopicsOf, issue};
use gdp_core::identity::{Identity, SigningKey};

use super::*;
use crate::config::Thing;

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
    assert_eq!(shared.exposed.exports, [Pattern::parse("/robot7/cmd_vel").unwrap()]);
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
    assert_eq!(shared.exposed.readers[0].topics, [Pattern::parse("/**").unwrap()]);
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
    assert_eq!(of_robot7.exposed.readers[0].topics, [Pattern::parse("/camera/**").unwrap()]);
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
