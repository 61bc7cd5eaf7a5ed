//! Actions of both dialects: either one makes the other, and their messages map.

mod common;

use common::{Ros1, Ros2, transcode};
use gdp_msg::{Action, ActionError, ActionPart, Dialect, InterfaceKind, Registry, TypeName, hash};

const TEXT: &str = "int8 kind\nfloat64 x\n---\nint8 code\nfloat64[] path\nstring text\n---\n";

#[test]
fn either_dialect_makes_the_other() {
    for dialect in [Ros1, Ros2] {
        let action = Action::resolve(&registry(dialect), &name()).unwrap();
        let goal = action.ros1(ActionPart::Goal).unwrap();
        assert_eq!(goal.name().to_string(), "test_msgs/msg/DoActionGoal");
        let (made, known) =
            (goal.text(), "std_msgs/Header header\nactionlib_msgs/GoalID goal_id\ntest_msgs/DoGoal goal\n");
        assert!(made.starts_with(known), "{made}");
        // The same whatever it was made of.
        let both = Action::resolve(&both(), &name()).unwrap();
        for part in [ActionPart::Goal, ActionPart::Result, ActionPart::Feedback] {
            let md5sum = |action: &Action| hash::md5sum(&action.ros1(part).unwrap());
            assert_eq!(md5sum(&action), md5sum(&both));
        }
        let rihs = |action: &Action| hash::type_hash(&action.ros2().unwrap());
        assert_eq!(rihs(&action), rihs(&both));
        // Its text is enough for a peer.
        let mut peer = Registry::default();
        peer.add_text(Ros2, &name(), &action.ros2().unwrap().text()).unwrap();
        assert_eq!(rihs(&Action::resolve(&with_common(peer), &name()).unwrap()), rihs(&both));
    }
    let unknown = Action::resolve(&Registry::embedded(), &name()).unwrap_err();
    assert_eq!(unknown, ActionError::Unknown(name()));
}

#[test]
fn goals_results_and_feedback_map_both_ways() {
    let action = Action::resolve(&registry(Ros1), &name()).unwrap();
    let both_ways = |part, ros1: &[u8], ros2: &[u8]| {
        let there = transcode(&action.mapping(part, Ros1).unwrap(), ros1).unwrap();
        assert_eq!(there, ros2, "{part:?}");
        assert_eq!(transcode(&action.mapping(part, Ros2).unwrap(), ros2).unwrap(), ros1, "{part:?}");
    };
    let (x, y) = (1.5f64.to_le_bytes(), 2.5f64.to_le_bytes());
    both_ways(ActionPart::Goal, &[&[7][..], &x].concat(), &[&[0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0][..], &x].concat());
    // The status in front moves what follows.
    let ros1 = [&[4, 9, 1, 0, 0, 0][..], &y, &[1, 0, 0, 0, b'a']].concat();
    let ros2 = [&[0, 1, 0, 0, 4, 9, 0, 0, 1, 0, 0, 0][..], &y, &[2, 0, 0, 0, b'a', 0]].concat();
    both_ways(ActionPart::Result, &ros1, &ros2);
    both_ways(ActionPart::Feedback, &[], &[0, 1, 0, 0, 0]);
    assert_eq!(action.empty_result().unwrap(), [0; 1 + 4 + 4]);
}

#[test]
fn an_action_of_both_distributions_maps_and_has_the_sums_of_genpy() {
    let name = TypeName::parse("tf2_msgs/action/LookupTransform").unwrap();
    let action = Action::resolve(&Registry::embedded(), &name).unwrap();
    for (part, md5sum) in [
        (ActionPart::Goal, "f2e7bcdb75c847978d0351a13e699da5"),
        (ActionPart::Result, "ac26ce75a41384fa8bb4dc10f491ab90"),
        (ActionPart::Feedback, "aae20e09065c3809e8a8e87c4c8953fd"),
    ] {
        assert_eq!(hash::md5sum(&action.ros1(part).unwrap()), md5sum);
        for from in [Ros1, Ros2] {
            assert!(action.mapping(part, from).unwrap().notes().is_empty(), "{part:?}");
        }
    }
}

#[test]
fn one_version_of_a_part_may_have_more_fields() {
    let mut registry = registry(Ros1);
    registry.add_file(Ros2, &name(), &TEXT.replace("float64 x", "float64 x\nfloat64 speed")).unwrap();
    let action = Action::resolve(&registry, &name()).unwrap();
    let mapping = action.mapping(ActionPart::Goal, Ros1).unwrap();
    assert_eq!(mapping.notes().len(), 1, "{:?}", mapping.notes());
}

fn name() -> TypeName {
    TypeName::new("test_msgs", InterfaceKind::Action, "Do").unwrap()
}

fn registry(dialect: Dialect) -> Registry {
    let mut registry = Registry::embedded();
    registry.add_file(dialect, &name(), TEXT).unwrap();
    registry
}

fn both() -> Registry {
    let mut registry = registry(Ros1);
    registry.add_file(Ros2, &name(), TEXT).unwrap();
    registry
}

/// What wraps actions in both dialects comes from the embedded definitions.
fn with_common(peer: Registry) -> Registry {
    let mut registry = Registry::embedded();
    for definition in peer.names(Ros2).filter_map(|name| peer.get(Ros2, name)) {
        if definition.name.kind() == InterfaceKind::Action {
            let text = gdp_msg::Schema::resolve(&peer, Ros2, &definition.name).unwrap().text();
            registry.add_text(Ros2, &definition.name, &text).unwrap();
        }
    }
    registry
}
