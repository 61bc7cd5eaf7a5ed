//! Unit tests of `automatic::listed`.

use std::time::Duration;

use gdp_core::cert::{Grantee, MemberCert, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::name::Metadata;
use gdp_ros::catalog::{CATALOG, Entry};

use super::*;
use crate::config::What;

const NOW: u64 = 1_800_000_000;

#[test]
fn what_is_listed_is_what_this_proxy_may_read() {
    let (owner, stranger, now) = (key(), key(), Instant::now());
    let domain = Identity::generate("domain").unwrap();
    let role = Grantee::Role { domain: domain.name(), role: "operator".into() };
    let me = Grantee::Entity(name(1));
    let entries = vec![
        entry(&owner, "topic", "/mine", &owner, &[Grantee::Entity(name(9)), me.clone()]),
        entry(&owner, "topic", "/role", &owner, std::slice::from_ref(&role)),
        entry(&owner, "topic", "/theirs", &owner, &[Grantee::Entity(name(9))]),
        entry(&owner, "topic", "/forged", &stranger, std::slice::from_ref(&me)),
        entry(&owner, "topic", "no name", &owner, std::slice::from_ref(&me)),
    ];
    let mut catalogs = Catalogs::new(owner.verify_key(), name(1));
    let body = Catalog::new(entries).unwrap().to_bytes().unwrap();
    assert!(catalogs.take(&message(2, 1, &body), || None, now, NOW).unwrap());
    let names = |catalogs: &Catalogs| catalogs.all().iter().map(|it| it.name.to_string()).collect::<Vec<_>>().join(" ");
    assert_eq!(names(&catalogs), "/mine");

    let (entity, role) = (name(1), "operator".into());
    let claims = MemberCert { domain: domain.name(), entity, role, serial: 1, not_before: 0, not_after: u64::MAX };
    let member = || Some(Membership::issue(&domain, &claims).unwrap());
    assert!(!catalogs.take(&message(2, 2, &body), member, now, NOW + 1).unwrap(), "it was verified just now");
    assert!(catalogs.take(&message(2, 3, &body), member, now, NOW + AGAIN).unwrap());
    assert_eq!(names(&catalogs), "/mine /role");
}

#[test]
fn a_catalog_holds_until_its_writer_is_silent_and_an_earlier_one_changes_nothing() {
    let (owner, now) = (key(), Instant::now());
    let body = |topics: &[&str]| {
        let entries = topics.iter().map(|topic| entry(&owner, "topic", topic, &owner, &[Grantee::Entity(name(1))]));
        Catalog::new(entries.collect()).unwrap().to_bytes().unwrap()
    };
    let mut catalogs = Catalogs::new(owner.verify_key(), name(1));
    let take = |catalogs: &mut Catalogs, writer, sequence, topics: &[&str], now| {
        catalogs.take(&message(writer, sequence, &body(topics)), || None, now, NOW).unwrap()
    };
    assert!(take(&mut catalogs, 2, 5, &["/a", "/b"], now));
    assert!(!take(&mut catalogs, 2, 4, &[], now));
    assert!(!take(&mut catalogs, 1, 4, &["/own"], now), "its own are not for itself");
    assert!(take(&mut catalogs, 3, 0, &["/c"], now + LEASE / 2));
    assert_eq!(catalogs.all().len(), 3);
    assert!(catalogs.poll(now + LEASE) && !catalogs.poll(now + LEASE));
    assert_eq!(catalogs.all().len(), 1);
    for writer in 10..25 {
        take(&mut catalogs, writer, 0, &[], now + LEASE / 2);
    }
    let more = catalogs.take(&message(40, 0, &body(&[])), || None, now, NOW);
    assert!(matches!(more, Err(CatalogError::TooMuch { .. })));
    assert!(catalogs.take(&message(3, 1, b"no catalog"), || None, now, NOW).is_err());
    assert!(catalogs.poll(now + LEASE * 2 + Duration::from_secs(1)) && catalogs.all().is_empty());
}

#[test]
fn patterns_choose_deny_wins_and_names_are_local() {
    let owner = key();
    let says = "{catalog: c, grant: g, topics: [/camera/**, /odom], services: [/**], deny: [/camera/raw], \
                remap: [{from: /odom, to: /where}], prefix: /r1}";
    let config: ImportConfig = serde_saphyr::from_str(says).unwrap();
    let listed = |thing: Thing, name: &str| {
        let Entry { metadata, mut grants } = entry(&owner, thing.as_str(), name, &owner, &[me()]);
        let name = TopicName::parse(name).unwrap();
        let card = NameCard::new(owner.verify_key(), metadata).unwrap();
        Listed { card, thing, name, kind: None, right: Reading { grant: grants.remove(0), member: None } }
    };
    let topics = ["/camera/left", "/camera/raw", "/odom", "/odometry", "/where"];
    let services = ["/camera/raw", "/camera/set", "/camera/set_parameters", "/odom"];
    let all: Vec<Listed> = topics
        .map(|name| listed(Thing::Topic, name))
        .into_iter()
        .chain(services.map(|name| listed(Thing::Call(What::Service), name)))
        .chain([listed(Thing::Call(What::Action), "/dock")])
        .collect();
    let chosen = chosen(&config, &all);
    let titles: Vec<String> = chosen.keys().map(|(thing, name)| thing.title(name)).collect();
    assert_eq!(titles, ["topic /r1/camera/left", "topic /r1/where", "service /r1/camera/set", "service /r1/where"]);
}

#[test]
fn what_is_called_is_listed_with_or_without_its_type_and_nothing_that_no_proxy_lists() {
    let (owner, now) = (key(), Instant::now());
    let cases = [
        ("service", "/a", "a/srv/B", true),
        ("service", "/b", "", true),
        ("action", "/c", "a/action/B", true),
        ("topic", "/d", "a/msg/B", true),
        ("topic", "/e", "", false),
        ("service", "/f", "a/msg/B", false),
        ("action", "/g", "a/srv/B", false),
        ("service", "/h", "no type", false),
        ("service", "no name", "", false),
        ("parameter", "/i", "a/msg/B", false),
        ("", "/j", "a/msg/B", false),
    ];
    let entries = cases.map(|(kind, name, of, _)| entry_of(&owner, kind, name, of, &owner, &[me()]));
    let body = Catalog::new(entries.into()).unwrap().to_bytes().unwrap();
    let mut catalogs = Catalogs::new(owner.verify_key(), name(1));
    assert!(catalogs.take(&message(2, 1, &body), || None, now, NOW).unwrap());
    let mut listed: Vec<_> = catalogs.all().iter().map(|it| it.thing.title(&it.name)).collect();
    listed.sort();
    assert_eq!(listed, ["action /c", "service /a", "service /b", "topic /d"]);
}

fn me() -> Grantee {
    Grantee::Entity(name(1))
}

fn entry(owner: &SigningKey, kind: &str, topic: &str, signer: &SigningKey, to: &[Grantee]) -> Entry {
    entry_of(owner, kind, topic, "a/msg/B", signer, to)
}

fn entry_of(owner: &SigningKey, kind: &str, topic: &str, of: &str, signer: &SigningKey, to: &[Grantee]) -> Entry {
    let card = NameCard::create(owner.verify_key(), kind, topic, of, Some("n".into())).unwrap();
    let grant = |to: &Grantee| {
        let claims = ReadGrant { name: card.name(), to: to.clone(), serial: 1, not_before: 0, not_after: u64::MAX };
        issue(signer, &claims).unwrap().into()
    };
    let metadata: Metadata = card.metadata().clone();
    Entry { metadata, grants: to.iter().map(grant).collect() }
}

fn message(writer: u8, sequence: u64, body: &[u8]) -> Message {
    Message {
        name: name(0),
        writer: name(writer),
        session: [0; 16],
        sequence,
        timestamp_ns: 0,
        encoding: CATALOG,
        in_reply_to: None,
        origin: bytes::Bytes::new(),
        latched: None,
        service: None,
        body: body.to_vec().into(),
    }
}

fn key() -> SigningKey {
    SigningKey::generate().unwrap()
}

fn name(byte: u8) -> Name {
    Name::from_bytes([byte; 32])
}
