//! Unit tests of `config::action_topic`.

use super::*;

#[test]
fn five_topics_are_of_an_action() {
    let of = |topic: &str, kind: &str| {
        let action = action_of_topic(&TopicName::parse(topic).unwrap(), Some(&TypeName::parse(kind).unwrap()));
        action.map(|action| action.to_string())
    };
    for (topic, kind) in [
        ("/a/dock/goal", "dock_msgs/msg/DockActionGoal"),
        ("/a/dock/cancel", "actionlib_msgs/msg/GoalID"),
        ("/a/dock/status", "actionlib_msgs/msg/GoalStatusArray"),
        ("/a/dock/feedback", "dock_msgs/msg/DockActionFeedback"),
        ("/a/dock/result", "dock_msgs/msg/DockActionResult"),
    ] {
        assert_eq!(of(topic, kind).as_deref(), Some("/a/dock"));
        assert_eq!(of(topic, "std_msgs/msg/String"), None);
    }
    assert_eq!(of("/goal", "dock_msgs/msg/DockActionGoal"), None);
    assert_eq!(of("/a/dock/other", "dock_msgs/msg/DockActionGoal"), None);
    assert_eq!(action_of_topic(&TopicName::parse("/a/goal").unwrap(), None), None);
}

#[test]
fn the_goals_tell_the_type() {
    let kind = |goal: &str| action_type(&TypeName::parse(goal).unwrap()).map(|kind| kind.to_string());
    assert_eq!(kind("dock_msgs/msg/DockActionGoal").as_deref(), Some("dock_msgs/action/Dock"));
    for other in ["dock_msgs/msg/ActionGoal", "dock_msgs/msg/DockGoal", "std_msgs/msg/String"] {
        assert_eq!(kind(other), None, "{other}");
    }
}
