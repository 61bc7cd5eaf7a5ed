//! Unit tests of `call::material`.

use std::fs;

use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};

use super::*;
use crate::material::tests::{Files, watcher};
use crate::material::{Material, Permission};

/// With a name of this kind and type, and what is said of it.
fn load(kind: &str, of: &str, said: &str) -> Result<Vec<RouteMaterial>, MaterialError> {
    load_marked(kind, of, said, &[])
}

/// The same, with more metadata in the name card.
fn load_marked(kind: &str, of: &str, said: &str, marks: &[(&str, &str)]) -> Result<Vec<RouteMaterial>, MaterialError> {
    let files = Files::new();
    let card = NameCard::create(files.owner.verify_key(), kind, "/light", of, None).unwrap();
    let mut metadata = card.metadata().clone();
    metadata.extend(marks.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())));
    let card = NameCard::new(*card.owner_key(), metadata).unwrap();
    card.save_new(&files.path("light.card")).unwrap();
    let cert = AdCert { name: card.name(), ..files.claims() };
    fs::write(files.path("light.ad"), issue(&files.owner, &cert).unwrap().to_pem()).unwrap();
    let (name, to) = (card.name(), Grantee::Entity(cert.entity));
    let grant = ReadGrant { name, to, serial: 1, not_before: 0, not_after: u64::MAX };
    fs::write(files.path("light.grant"), issue(&files.owner, &grant).unwrap().to_pem()).unwrap();
    let text = format!("{{version: 1, identity: id.pem, links: [{{to: 'eth://r0'}}], services: [{said}]}}");
    let config = Config::parse(&text, &files.path("robot.yaml")).unwrap();
    Material::load(&config, &watcher()).map(|material| material.calls.into_iter().map(|(_, call)| call).collect())
}

const LIGHT: &str = "{service: /light, direction: out, card: light.card, cert: light.ad}";

#[test]
fn files_that_belong_together_are_taken() {
    let loaded = load("service", "std_srvs/srv/SetBool", LIGHT).unwrap();
    let [light] = &loaded[..] else { panic!("one service") };
    assert_eq!(light.kind.as_ref().unwrap().as_str(), "std_srvs/srv/SetBool");
    assert!(matches!(light.permission, Permission::Publish(_)));
}

#[test]
fn only_the_owner_lets_a_call_go_to_several_servers() {
    let said = "{service: /light, direction: in, card: light.card, grant: light.grant, replicate: 2}";
    let load = |kind, marks: &[_]| load_marked(kind, "std_srvs/srv/SetBool", said, marks);
    assert_eq!(load("service", &[("idempotent", "true")]).unwrap().len(), 1);
    for marks in [&[][..], &[("idempotent", "no")]] {
        let refusal = load("service", marks).err().expect("a refusal").to_string();
        assert!(refusal.starts_with("services[0].replicate: the owner has not marked"), "{refusal}");
        assert!(refusal.contains("light.card") && refusal.contains("--idempotent"), "{refusal}");
    }
}

#[test]
fn what_does_not_fit_is_named() {
    let refusal = |kind, of, said: &str| load(kind, of, said).err().expect("a refusal").to_string();
    let of_topic = refusal("topic", "std_srvs/srv/SetBool", LIGHT);
    assert!(of_topic.starts_with("services[0].card: ") && of_topic.contains("make one of kind service"), "{of_topic}");
    let typed = LIGHT.replace("card:", "type: std_srvs/srv/Trigger, card:");
    let other_type = refusal("service", "std_srvs/srv/SetBool", &typed);
    assert!(other_type.starts_with("services[0].type: ") && other_type.contains("SetBool"), "{other_type}");
    let twice = format!("{LIGHT}, {}", LIGHT.replace("/light", "/lamp"));
    let same_name = refusal("service", "", &twice);
    assert!(same_name.starts_with("services[1].card: "), "{same_name}");
}
