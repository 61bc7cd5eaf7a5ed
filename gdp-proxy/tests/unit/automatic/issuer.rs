//! Unit tests of `automatic::issuer`.

use std::collections::BTreeMap;

use super::*;
use crate::config::{ReaderConfig, RuleOptions, What};
use crate::ros2::TopicName;

const NOW: u64 = 1_800_000_000_000_000_000;

#[test]
fn a_name_is_the_same_every_time_and_another_for_everything_else() {
    let (owner, other) = (SigningKey::generate().unwrap(), SigningKey::generate().unwrap());
    let name = |owner: &SigningKey, thing: Thing, topic: &str, kind: &str, meta: &str| {
        let meta = BTreeMap::from([("site".into(), meta.into())]);
        let exposed = Exposed {
            name: TopicName::parse(topic).unwrap(),
            rule_options: RuleOptions { meta, ..RuleOptions::default() },
        };
        let kind = TypeName::parse(kind).ok();
        Issuer::new(owner.clone(), entity()).card(thing, kind.as_ref(), &exposed).unwrap().name()
    };
    let (topic, service) = (Thing::Topic, Thing::Call(What::Service));
    let first = name(&owner, topic, "/a", "a/msg/A", "x");
    assert_eq!(first, name(&owner, topic, "/a", "a/msg/A", "x"));
    let others = [
        name(&other, topic, "/a", "a/msg/A", "x"),
        name(&owner, service, "/a", "a/msg/A", "x"),
        name(&owner, topic, "/b", "a/msg/A", "x"),
        name(&owner, topic, "/a", "a/msg/B", "x"),
        name(&owner, topic, "/a", "", "x"),
        name(&owner, topic, "/a", "a/msg/A", "y"),
    ];
    assert!(others.iter().all(|other| *other != first));
}

#[test]
fn papers_are_good_for_this_proxy_and_its_readers_and_grow_old() {
    let owner = SigningKey::generate().unwrap();
    let issuer = Issuer::new(owner.clone(), entity());
    let exposed = Exposed { name: TopicName::parse("/a").unwrap(), rule_options: RuleOptions::default() };
    let card = issuer.card(Thing::Topic, TypeName::parse("a/msg/A").ok().as_ref(), &exposed).unwrap();
    assert_eq!((card.get("topic"), card.get("nonce").unwrap().len()), (Some("/a"), 32));
    let mut config: ExposeConfig = serde_saphyr::from_str("{owner: o, catalog: c, topics: [/a]}").unwrap();
    let to = Grantee::Role { domain: entity(), role: "operator".into() };
    config.readers = vec![ReaderConfig(Grantee::Entity(entity())), ReaderConfig(to.clone())];
    let credentials = issuer.issue(card.name(), None, &config, NOW).unwrap();
    let seconds = NOW / 1_000_000_000;
    assert_eq!(credentials.cert.verify(&card.proof(), None, seconds).unwrap().entity, entity());
    assert_eq!(credentials.grants[1].verify(&card.proof(), None, seconds).unwrap().to, to);
    credentials.grants[1].verify(&card.proof(), None, seconds + LIFETIME + 1).unwrap_err();
    let hours = |hours: i64| credentials.are_old(NOW.saturating_add_signed(hours * 3_600_000_000_000));
    assert_eq!([0, 11, 12, 30, -1].map(hours), [false, false, true, true, true]);
}

fn entity() -> Name {
    Name::from_bytes([7; 32])
}
