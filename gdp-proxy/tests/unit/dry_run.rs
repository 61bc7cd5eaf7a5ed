//! Unit tests of `dry_run`.

use std::fs;

use gdp_core::cert::{AdCert, issue};

use super::*;
use crate::config::CallConfig;
use crate::material::Material;
use crate::material::tests::{Files, watcher};

#[test]
fn of_publishers_of_several_types_it_is_shown_who_crosses_and_why_others_do_not() {
    let files = Files::new();
    files.owner.save_new(&files.path("owner.pem")).unwrap();
    let mut config = files.config("");
    let expose = "{owner: owner.pem, catalog: t.card, topics: [/**], services: [/**], deny: [/d], types: [a/msg/B, \
                  a/msg/C, a/srv/S]}";
    let mut expose: ExposeConfig = serde_saphyr::from_str(expose).unwrap();
    (expose.owner, expose.catalog) = (files.path("owner.pem"), files.path("other.card"));
    let catalog = gdp_core::card::NameCard::create(files.owner.verify_key(), "catalog", "/robot", "", None).unwrap();
    catalog.save_new(&expose.catalog).unwrap();
    config.expose = Some(expose);
    let card = gdp_core::card::NameCard::create(files.owner.verify_key(), "service", "/listed", "", None).unwrap();
    card.save_new(&files.path("s.card")).unwrap();
    let cert = AdCert { name: card.name(), ..files.claims() };
    fs::write(files.path("s.ad"), issue(&files.owner, &cert).unwrap().to_pem()).unwrap();
    let name = TopicName::parse("/listed").unwrap();
    let call = CallConfig::without_files(What::Service, &name, "ros2", None, Side::Out);
    config.services.push(CallConfig { card: files.path("s.card"), cert: Some(files.path("s.ad")), ..call });
    let loaded = Loaded { material: Material::load(&config, &watcher()).unwrap(), config };

    let offered = |kinds: &str| {
        let kind = |kind| Offered { kind: TypeName::parse(kind).ok(), qos: None };
        kinds.split(' ').map(kind).collect::<Vec<_>>()
    };
    let topic = |name: &str| (Thing::Topic, TopicName::parse(name).unwrap());
    let service = |name: &str| (Thing::Call(What::Service), TopicName::parse(name).unwrap());
    let string = "std_msgs/msg/String";
    let found = Found::from([
        (topic("/a"), offered("a/msg/A a/msg/B a/msg/C a/msg/B")),
        (topic("/chatter"), offered("a/msg/A std_msgs/msg/String")),
        (topic("/d"), offered("a/msg/B a/msg/C")),
        (service("/s"), offered("a/srv/S")),
        (service("/d"), offered("a/srv/S")),
        (service("/listed"), offered("a/srv/L")),
        (service("/o"), offered("a/srv/O")),
        (service("/untyped"), vec![Offered { kind: None, qos: None }]),
        (service("/talker/get_parameters"), offered("a/srv/S")),
    ]);
    let report = report(&loaded, &BTreeMap::from([("ros2".into(), found)])).unwrap();
    let shown = |topic: &str| {
        let rows = report.topics.iter().filter(|row| row.of.name() == topic);
        rows.map(|row| (row.kind.as_deref().unwrap(), row.direction, row.because.as_str())).collect::<Vec<_>>()
    };
    let crosses_as = |kind| another_type(Some(&TypeName::parse(kind).unwrap()));
    assert_eq!(
        shown("/a"),
        [
            ("a/msg/A", None, "its type is not one of types"),
            ("a/msg/B", Some(Side::Out), "expose"),
            ("a/msg/C", None, &crosses_as("a/msg/B")),
        ]
    );
    assert_eq!(shown("/chatter"), [(string, Some(Side::Out), "topics[0]"), ("a/msg/A", None, &crosses_as(string))]);
    assert_eq!(shown("/d"), [("a/msg/B", None, "deny has /d"), ("a/msg/C", None, "deny has /d")]);
    let calls: Vec<_> =
        report.calls.iter().map(|row| (row.of.name(), row.name.is_some(), row.because.as_str())).collect();
    assert_eq!(
        calls,
        [
            ("/listed", true, "services[0]"),
            ("/d", false, "deny has /d"),
            ("/o", false, "its type is not one of types"),
            ("/s", true, "expose"),
            ("/untyped", false, "its type is not one of types"),
        ]
    );
}
