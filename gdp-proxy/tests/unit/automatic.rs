//! Plans of what crosses by itself, in a graph whose master does not answer.

use std::fs;
use std::path::Path;

use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::SigningKey;

use super::*;
use crate::config::{Config, What};
use crate::graph::{Found, Offered};
use crate::material::Material;
use crate::material::tests::{Files, watcher};
use crate::ros2::{TopicName, TypeName};

#[tokio::test]
async fn a_name_that_is_listed_twice_is_read_once_and_the_rest_is_told() {
    let files = Files::new();
    for label in ["one", "two"] {
        let card = NameCard::create(files.owner.verify_key(), "catalog", label, "", None).unwrap();
        card.save_new(&files.path(&format!("{label}.card"))).unwrap();
        let (name, to) = (card.name(), Grantee::Entity(files.entity));
        let grant = ReadGrant { name, to, serial: 1, not_before: 0, not_after: u64::MAX };
        fs::write(files.path(&format!("{label}.grant")), issue(&files.owner, &grant).unwrap().to_pem()).unwrap();
    }
    let (loaded, graphs) = load(
        &files,
        "topics: [{topic: /chatter, direction: in, card: t.card, grant: t.grant}], import: [\
         {catalog: one.card, grant: one.grant, topics: [/**], prefix: /one}, \
         {catalog: two.card, grant: two.grant, topics: [/**], prefix: /two}]",
    )
    .await;
    let mut automatic = Automatic::new(&loaded, &graphs, files.entity, &[], None).unwrap();
    let (config, material) = (loaded.config.topics[0].clone(), loaded.material.routes[0].1.clone());
    let explicit = [Arc::new(RoutePlan { config, label: "a".into(), graph: graphs["a"].clone(), material })];

    let [a, b] = ["/a", "/b"]
        .map(|topic| NameCard::create(files.owner.verify_key(), "topic", topic, "std_msgs/msg/String", None).unwrap());
    let list = |import: &Import, cards: &[&NameCard]| {
        let listed = cards.iter().map(|card| Listed {
            card: (*card).clone(),
            thing: Thing::parse(card.get("kind").unwrap()).unwrap(),
            name: TopicName::parse(card.get("topic").unwrap()).unwrap(),
            kind: TypeName::parse(card.get("type").unwrap()).ok(),
            right: import.material.grant.clone(),
        });
        import.tell.send_replace(listed.collect());
    };
    list(&automatic.imports[0], &[&files.card, &a]);
    list(&automatic.imports[1], &[&a, &b]);
    for _ in 0..2 {
        let routes = automatic.plan(&explicit, &[]).routes;
        let topics: Vec<_> = routes.iter().map(|plan| plan.config.topic.as_str()).collect();
        assert_eq!(topics, ["/chatter", "/one/a", "/two/b"]);
        let told: Vec<_> =
            automatic.planner_state.omissions.known().iter().map(|(what, why)| format!("{what}: {why}")).collect();
        assert!(
            told[0].starts_with("topic /one/chatter: its name ")
                && told[0].contains("is already that of topic /chatter")
        );
        assert!(
            told[1].starts_with("topic /two/a: its name ") && told[1].contains("is already that of topic /one/a"),
            "{told:?}"
        );
        assert_eq!(told.len(), 2);
    }
    drop((automatic, explicit));
    graph::leave(graphs).await;
}

#[tokio::test]
async fn what_finds_no_room_in_the_catalog_is_told_and_the_rest_is_listed() {
    let files = Files::new();
    let owner = SigningKey::generate().unwrap();
    owner.save_new(&files.path("owner.pem")).unwrap();
    let catalog = NameCard::create(owner.verify_key(), "catalog", "/robot", "", None).unwrap();
    catalog.save_new(&files.path("catalog.card")).unwrap();
    let readers: Vec<String> = (0..64).map(|i| Name::from_bytes([0xa0 + i; 32]).to_string()).collect();
    let readers = readers.join(", ");
    let expose = format!("expose: {{owner: owner.pem, catalog: catalog.card, topics: [/**], readers: [{readers}]}}");
    let (loaded, graphs) = load(&files, &expose).await;
    let mut automatic = Automatic::new(&loaded, &graphs, files.entity, &[], None).unwrap();
    let offered = || vec![Offered { kind: TypeName::parse("std_msgs/msg/String").ok(), qos: None }];
    let topic = |i| (Thing::Topic, TopicName::parse(&format!("/t{i:03}")).unwrap());
    let topics: Found = (0..500).map(|i| (topic(i), offered())).collect();
    // They have gone when it is planned, but just now.
    let exposed = automatic.expose.as_mut().unwrap();
    exposed.choice.update(loaded.config.expose.as_ref().unwrap(), &topics, Instant::now());

    let plans = automatic.plan(&[], &[]);
    let [CatalogPlan { end: End::Writes(_, list), .. }] = &plans.catalogs[..] else { panic!("one catalog") };
    let listed = Catalog::read(&list.borrow(), owner.verify_key()).unwrap();
    assert!((100..500).contains(&listed.len()), "{}", listed.len());
    assert_eq!(
        (plans.routes.len(), automatic.planner_state.omissions.known().len()),
        (listed.len(), 500 - listed.len())
    );
    assert!(automatic.planner_state.omissions.known().iter().all(|(_, reason)| *reason == Reason::CatalogHasAllBytes));
    drop((automatic, plans));
    graph::leave(graphs).await;
}

#[tokio::test]
async fn services_are_listed_and_carried_as_calls_unless_the_configuration_lists_them_itself() {
    let files = Files::new();
    let owner = SigningKey::generate().unwrap();
    owner.save_new(&files.path("owner.pem")).unwrap();
    let catalog = NameCard::create(owner.verify_key(), "catalog", "/robot", "", None).unwrap();
    catalog.save_new(&files.path("catalog.card")).unwrap();
    let card = NameCard::create(files.owner.verify_key(), "service", "/light", "", None).unwrap();
    card.save_new(&files.path("light.card")).unwrap();
    let cert = AdCert { name: card.name(), ..files.claims() };
    fs::write(files.path("light.ad"), issue(&files.owner, &cert).unwrap().to_pem()).unwrap();
    let (loaded, graphs) = load(
        &files,
        "services: [{service: /light, direction: out, card: light.card, cert: light.ad}], \
         expose: {owner: owner.pem, catalog: catalog.card, topics: [/a], services: [/**], remap: [{from: /b, to: /a}]}",
    )
    .await;
    let mut automatic = Automatic::new(&loaded, &graphs, files.entity, &[], None).unwrap();
    let offered = |thing, name, kind| {
        ((thing, TopicName::parse(name).unwrap()), vec![Offered { kind: TypeName::parse(kind).ok(), qos: None }])
    };
    let service = Thing::Call(What::Service);
    let found = Found::from([
        offered(Thing::Topic, "/a", "std_msgs/msg/String"),
        offered(service, "/a", "std_srvs/srv/Trigger"),
        offered(service, "/b", "std_srvs/srv/Trigger"),
        offered(service, "/light", "std_srvs/srv/SetBool"),
        offered(service, "/untyped", ""),
        offered(Thing::Call(What::Action), "/dock", "a/action/Dock"),
    ]);
    let exposed = automatic.expose.as_mut().unwrap();
    exposed.choice.update(loaded.config.expose.as_ref().unwrap(), &found, Instant::now());
    let (config, material) = (loaded.config.services[0].clone(), loaded.material.calls[0].1.clone());
    let explicit = [Arc::new(CallPlan { config, label: "a".into(), graph: graphs["a"].clone(), material })];

    let plans = automatic.plan(&[], &explicit);
    let [CatalogPlan { end: End::Writes(_, list), .. }] = &plans.catalogs[..] else { panic!("one catalog") };
    let listed = Catalog::read(&list.borrow(), owner.verify_key()).unwrap();
    let mut listed: Vec<_> =
        listed.iter().map(|(card, _)| ["kind", "topic", "type"].map(|key| card.get(key))).collect();
    listed.sort();
    let expected = [
        ["service", "/a", "std_srvs/srv/Trigger"],
        ["service", "/untyped", ""],
        ["topic", "/a", "std_msgs/msg/String"],
    ];
    assert_eq!(listed, expected.map(|entry| entry.map(Some)));
    let names: Vec<_> = plans.calls.iter().map(|plan| plan.config.name.as_str()).collect();
    assert_eq!((names, plans.routes.len()), (vec!["/light", "/a", "/untyped"], 1));
    let told = automatic
        .planner_state
        .omissions
        .known()
        .iter()
        .map(|(what, why)| format!("{what}: {why}"))
        .collect::<Vec<_>>();
    assert_eq!(told, ["service /b: remap gives it the name of another"]);
    drop((automatic, plans, explicit));
    graph::leave(graphs).await;
}

async fn load(files: &Files, says: &str) -> (Loaded, graph::All) {
    let text = format!(
        "{{version: 1, identity: id.pem, links: [{{to: 'eth://r0'}}], \
         graphs: {{a: {{master: 'http://127.0.0.1:1', host: 127.0.0.1}}}}, {says}}}"
    );
    let config = Config::parse(&text, Path::new(&files.path("robot.yaml"))).unwrap();
    let material = Material::load(&config, &watcher()).unwrap();
    let mut graphs = graph::All::new();
    graph::join(&mut graphs, &config.graphs, "gdp_proxy_test").await.unwrap();
    (Loaded { config, material }, graphs)
}
