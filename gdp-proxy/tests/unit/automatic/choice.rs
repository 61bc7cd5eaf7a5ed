//! Unit tests of `automatic::choice`.

use super::*;
use crate::config::What;

#[test]
fn deny_wins_and_nothing_is_exposed_that_is_not_named() {
    let config = config(
        "topics: [/camera/**, /odom, /rosout], deny: [/camera/raw, /**/secret/**, /parameter*], types: [a/msg/B]",
    );
    let check_exposed = |topic: &str, kind: &str| {
        check_exposed(&config, Thing::Topic, &name(topic), TypeName::parse(kind).ok().as_ref()).map(|it| it.name)
    };
    assert_eq!(check_exposed("/camera/left", "a/msg/B"), Ok(name("/camera/left")));
    assert_eq!(check_exposed("/camera/raw", "a/msg/B"), Err(NotExposed::Denied("/camera/raw".into())));
    assert_eq!(check_exposed("/camera/secret/x", "a/msg/B"), Err(NotExposed::Denied("/**/secret/**".into())));
    assert_eq!(check_exposed("/cmd_vel", "a/msg/B"), Err(NotExposed::NoPattern(Thing::Topic)));
    assert_eq!(check_exposed("/camera/_hidden", "a/msg/B"), Err(NotExposed::Hidden(Thing::Topic)));
    assert_eq!(check_exposed("/rosout", "a/msg/B"), Ok(name("/rosout")));
    assert_eq!(check_exposed("/odom", "a/msg/C"), Err(NotExposed::OtherType));
}

#[test]
fn the_first_pattern_says_how() {
    let config =
        config("topics: [{topic: /a, max_hz: 1}, /**], remap: [{from: /a, to: /r1/a}], defaults: {priority: 7}");
    let exposed = check_exposed(&config, Thing::Topic, &name("/a"), Some(&kind())).unwrap();
    assert_eq!((exposed.name, exposed.rule_options.max_hz.unwrap().get()), (name("/r1/a"), 1));
    assert_eq!(
        check_exposed(&config, Thing::Topic, &name("/b"), Some(&kind())).unwrap().rule_options.priority.unwrap().get(),
        7
    );
}

#[test]
fn what_is_called_is_exposed_by_its_own_patterns_and_none_that_nodes_have_for_themselves() {
    let config = config(
        "topics: [/a/topic], services: [/a/**, /b/get_parameters], actions: [/arm/*], deny: [/a/stop], \
         remap: [{from: /a, to: /r1/a}], defaults: {max_hz: 5, meta: {site: x}}",
    );
    let (service, action) = (Thing::Call(What::Service), Thing::Call(What::Action));
    let check_exposed =
        |thing, text: &str| check_exposed(&config, thing, &name(text), None).map(|it| it.name.to_string());
    assert_eq!(check_exposed(service, "/a/light"), Ok("/r1/a/light".into()));
    assert_eq!(check_exposed(service, "/a/stop"), Err(NotExposed::Denied("/a/stop".into())));
    assert_eq!(check_exposed(service, "/a/set_parameters"), Err(NotExposed::Hidden(service)));
    assert_eq!(check_exposed(service, "/b/get_parameters"), Ok("/b/get_parameters".into()));
    assert_eq!(check_exposed(service, "/arm/dock"), Err(NotExposed::NoPattern(service)));
    assert_eq!(check_exposed(action, "/arm/dock"), Ok("/arm/dock".into()));
    assert_eq!(check_exposed(Thing::Topic, "/a/light"), Err(NotExposed::NoPattern(Thing::Topic)));
    let rule_options = config.rule_options(service, &name("/a/light")).unwrap();
    assert_eq!((rule_options.max_hz, rule_options.meta["site"].as_str()), (None, "x"));
}

#[test]
fn the_topics_of_an_exposed_action_are_not_exposed() {
    let config = config("topics: [/**], actions: [/dock, /arm/*], deny: [/arm/secret]");
    let check = |topic: &str, kind: &str| {
        check_exposed(&config, Thing::Topic, &name(topic), TypeName::parse(kind).ok().as_ref()).map(|_| ())
    };
    let (goal, status) = ("a/msg/DockActionGoal", "actionlib_msgs/msg/GoalStatusArray");
    assert_eq!(check("/dock/goal", goal), Err(NotExposed::OfAction(name("/dock"))));
    assert_eq!(check("/arm/lift/status", status), Err(NotExposed::OfAction(name("/arm/lift"))));
    for (topic, kind) in [("/other/goal", goal), ("/arm/secret/goal", goal), ("/dock/goal", "a/msg/Goal")] {
        assert_eq!(check(topic, kind), Ok(()), "{topic} of {kind}");
    }
}

#[test]
fn where_types_are_named_what_has_none_is_not_exposed() {
    let config = config("services: [/**], types: [a/srv/B]");
    let check_exposed = |kind: Option<&str>| {
        let kind = kind.map(|kind| TypeName::parse(kind).unwrap());
        check_exposed(&config, Thing::Call(What::Service), &name("/a"), kind.as_ref()).map(|_| ())
    };
    assert_eq!(check_exposed(Some("a/srv/B")), Ok(()));
    assert_eq!([None, Some("a/srv/C")].map(check_exposed), [Err(NotExposed::OtherType), Err(NotExposed::OtherType)]);
}

#[test]
fn a_topic_stays_a_little_longer_than_its_publishers() {
    let (config, start) = (config("topics: [/**]"), Instant::now());
    let mut choice = Choice::default();
    let names = |choice: &Choice| choice.iter().map(|(_, name, ..)| name.to_string()).collect::<Vec<_>>().join(" ");
    choice.update(&config, &topics(&["/a", "/b", "/_c"]), start);
    assert_eq!((names(&choice), choice.due()), ("/a /b".into(), None));
    choice.update(&config, &topics(&["/b"]), start);
    assert_eq!((names(&choice), choice.due()), ("/a /b".into(), Some(start + GRACE)));
    // Back in time, and gone again.
    choice.update(&config, &topics(&["/a", "/b"]), start + GRACE / 2);
    assert_eq!(choice.due(), None);
    choice.update(&config, &topics(&["/b"]), start + GRACE);
    assert_eq!(names(&choice), "/a /b");
    choice.update(&config, &topics(&["/b"]), start + 2 * GRACE);
    assert_eq!((names(&choice), choice.due()), ("/b".into(), None));
}

#[test]
fn another_type_is_another_name_once_nobody_has_the_first() {
    let (config, now) = (config("topics: [/**]"), Instant::now());
    let mut choice = Choice::default();
    let of = |kinds: &[&str]| {
        let offered = |kind: &&str| Offered { kind: TypeName::parse(kind).ok(), qos: None };
        Found::from([((Thing::Topic, name("/a")), kinds.iter().map(offered).collect())])
    };
    let kind = |choice: &Choice| choice.iter().next().and_then(|(_, _, kind, _)| Some(kind?.to_string()));
    choice.update(&config, &of(&["x/msg/A"]), now);
    choice.update(&config, &of(&["x/msg/B", "x/msg/A"]), now);
    assert_eq!(kind(&choice).unwrap(), "x/msg/A");
    choice.update(&config, &of(&["x/msg/B"]), now);
    assert_eq!(kind(&choice).unwrap(), "x/msg/B");
}

#[test]
fn what_the_configuration_says_otherwise_counts_at_once() {
    let now = Instant::now();
    let mut choice = Choice::default();
    choice.update(&config("topics: [/**]"), &topics(&["/a", "/b"]), now);
    choice.update(&config("topics: [/**], deny: [/a]"), &topics(&["/a", "/b"]), now);
    assert_eq!(choice.iter().count(), 1);
}

fn config(says: &str) -> ExposeConfig {
    serde_saphyr::from_str(&format!("{{owner: o, catalog: c, {says}}}")).unwrap()
}

fn topics(names: &[&str]) -> Found {
    let offered = || vec![Offered { kind: Some(kind()), qos: None }];
    names.iter().map(|topic| ((Thing::Topic, name(topic)), offered())).collect()
}

fn name(text: &str) -> TopicName {
    TopicName::parse(text).unwrap()
}

fn kind() -> TypeName {
    TypeName::parse("std_msgs/msg/String").unwrap()
}
