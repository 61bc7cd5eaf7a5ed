//! Unit tests of `config::automatic`.

use std::path::Path;

use super::*;
use crate::config::Config;

#[test]
fn a_namespace_is_renamed_with_all_that_is_in_it_and_nothing_else() {
    let topic = |text: &str| TopicName::parse(text).unwrap();
    let remap = [("/camera/left", "/eye"), ("/camera", "/r1/camera")];
    let remap = remap.map(|(from, to)| Remap { from: topic(from), to: topic(to) });
    for (from, to) in [
        ("/camera/left/image", "/eye/image"),
        ("/camera/left", "/eye"),
        ("/camera/leftmost", "/r1/camera/leftmost"),
        ("/cameras", "/cameras"),
    ] {
        assert_eq!(remapped(&topic(from), &remap), Some(topic(to)));
    }
    let long = Remap { from: topic("/a"), to: topic(&format!("/{}", "b".repeat(200))) };
    assert_eq!(remapped(&topic(&format!("/a/{}", "c".repeat(100))), &[long]), None);
}

#[test]
fn a_pattern_says_what_differs() {
    let config: ExposeConfig = serde_saphyr::from_str(
        "owner: o\ncatalog: c\ntopics: [/a, {topic: /b/**, max_hz: 5, compression: none, meta: {floor: '2'}}]\n\
         defaults: {max_hz: 9, priority: 6, compression: zstd, frame_prefix: r1/, meta: {floor: '1', site: x}}\n",
    )
    .unwrap();
    let rule_options = |i: usize| config.topics[i].rule_options.or(&config.defaults);
    let meta = |i: usize| rule_options(i).meta.into_values().collect::<Vec<_>>().join(" ");
    assert_eq!((rule_options(0).max_hz.unwrap().get(), meta(0)), (9, "1 x".into()));
    assert_eq!((rule_options(1).max_hz.unwrap().get(), meta(1)), (5, "2 x".into()));
    let topic = rule_options(1).topic(&TopicName::parse("/b").unwrap(), "here", None, Direction::Out);
    assert_eq!((topic.priority.get(), topic.graph.as_deref(), topic.duplicate), (6, Some("here"), false));
    assert_eq!((topic.compression, topic.frame_prefix.unwrap().as_str()), (Compression::None, "r1/"));
    assert_eq!(rule_options(0).compression, Some(Compression::Zstd));
}

#[test]
fn idempotent_services_are_marked_and_nothing_else() {
    let config =
        "owner: o\ncatalog: c\ntopics: [/**]\nservices: [/map/*, /light]\nactions: [/**]\nidempotent: [/map/**]\n";
    let config: ExposeConfig = serde_saphyr::from_str(config).unwrap();
    let mark = |thing, name: &str| {
        let rule_options = config.rule_options(thing, &TopicName::parse(name).unwrap())?;
        Some(rule_options.meta.get(IDEMPOTENT).cloned())
    };
    let service = Thing::Call(What::Service);
    assert_eq!(mark(service, "/map/get_plan"), Some(Some("true".into())));
    assert_eq!([mark(service, "/light"), mark(service, "/map/of/all")], [Some(None), None]);
    assert_eq!([Thing::Topic, Thing::Call(What::Action)].map(|thing| mark(thing, "/map/a")), [Some(None), Some(None)]);
}

#[test]
fn something_must_be_meant_and_what_is_misspelt_is_named() {
    let parse = |graph: &str, says: &str| {
        let text =
            format!("{{version: 1, identity: i, links: [{{to: 'eth://r0'}}], graphs: {{a: {{{graph}}}}}, {says}}}");
        Config::parse(&text, Path::new("p.yaml")).map_err(|error| error.to_string())
    };
    let expose = |lists: &str| format!("expose: {{owner: o, catalog: c, {lists}}}");
    let import = |lists: &str| format!("import: [{{catalog: c, grant: g, {lists}}}]");
    let (ros1, ros2) = ("master: 'http://b:11311'", "domain_id: 1");
    for good in ["services: [/**]", "actions: [/dock]", "topics: [/a]"] {
        for graph in [ros1, ros2] {
            parse(graph, &format!("{}, {}", expose(good), import(good))).unwrap();
        }
    }
    for (graph, says, refusal) in [
        (ros2, expose("deny: [/a]"), "p.yaml: expose.topics: no pattern here"),
        (ros2, import("topics: []"), "p.yaml: import[0].topics: no pattern here"),
        (ros2, expose("service: [/**]"), "did you mean `services`?"),
        (ros2, expose("services: [{service: /a, max_hz: 5}]"), "p.yaml: "),
        (ros2, expose("services: [light]"), "is no pattern of names"),
        (ros2, expose("topics: [/a], idempotent: [/b]"), "p.yaml: expose.idempotent: is for services"),
        (ros2, expose("services: [/a], defaults: {meta: {idempotent: 'true'}}"), "p.yaml: expose.meta: idempotent is"),
        (ros2, import("topics: [/a], replicate: 2"), "p.yaml: import[0].replicate: is for services"),
        (ros2, import("services: [/a], replicate: 1"), "p.yaml: import[0].replicate: a call goes to 2 to 8 servers"),
    ] {
        let said = parse(graph, &says).unwrap_err();
        assert!(said.contains(refusal), "{says}: {said}");
    }
}

#[test]
fn frames_of_what_is_imported_get_a_prefix_as_its_topics_do() {
    let config = "catalog: c\ngrant: g\ntopics: [/**]\nprefix: /r2\nframe_prefix: r2/\n";
    let config: ImportConfig = serde_saphyr::from_str(config).unwrap();
    let topic = config.local_name(Thing::Topic, &TopicName::parse("/odom").unwrap()).unwrap();
    let topic = config.rule_options().topic(&topic, "here", None, Direction::In);
    assert_eq!((topic.topic.as_str(), topic.frame_prefix.unwrap().as_str()), ("/r2/odom", "r2/"));
}

#[test]
fn topics_that_merge_get_no_prefix() {
    let config = "catalog: c\ngrant: g\ntopics: [/**]\nprefix: /r2\nmerge: [/tf*, /rosout]\n";
    let config: ImportConfig = serde_saphyr::from_str(config).unwrap();
    let name = |text: &str| TopicName::parse(text).unwrap();
    let local = |thing, text: &str| config.local_name(thing, &name(text)).unwrap().to_string();
    assert_eq!(local(Thing::Topic, "/tf_static"), "/tf_static");
    assert_eq!(local(Thing::Topic, "/odom"), "/r2/odom");
    assert_eq!(local(Thing::Call(What::Service), "/tf"), "/r2/tf", "two servers would execute each call");
    assert!(!config.wants(Thing::Topic, &name("/rosout")), "a name that ROS uses itself is imported by name only");
}

#[test]
fn readers_are_entities_or_roles() {
    let name = "ab".repeat(32);
    let readers: Vec<ReaderConfig> =
        serde_saphyr::from_str(&format!("- {name}\n- {{domain: {name}, role: operator}}\n")).unwrap();
    let name: Name = name.parse().unwrap();
    let role = Grantee::Role { domain: name, role: "operator".into() };
    assert_eq!(readers, [ReaderConfig(Grantee::Entity(name)), ReaderConfig(role)]);
    for wrong in ["[12]", "[{domain: x}]", "[{domian: x, role: y}]"] {
        assert!(serde_saphyr::from_str::<Vec<ReaderConfig>>(wrong).is_err(), "{wrong}");
    }
}
