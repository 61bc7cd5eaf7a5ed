//! Recognises the topics of which an action of ROS 1 consists.

use crate::ros2::{TopicName, TypeName};

/// The topics, each with its type, or with the suffix of its type if that depends on the action.
const TOPICS: [(&str, &str); 5] = [
    ("goal", GOAL),
    ("cancel", "actionlib_msgs/msg/GoalID"),
    ("status", "actionlib_msgs/msg/GoalStatusArray"),
    ("feedback", "ActionFeedback"),
    ("result", "ActionResult"),
];

const GOAL: &str = "ActionGoal";

/// Returns the action that a topic with this name and type may be part of.
pub fn action_of_topic(topic: &TopicName, kind: Option<&TypeName>) -> Option<TopicName> {
    let (action, part) = topic.as_str().rsplit_once('/')?;
    let (_, suffix) = TOPICS.into_iter().find(|(name, _)| *name == part)?;
    kind?.as_str().ends_with(suffix).then(|| TopicName::parse(action).ok()).flatten()
}

/// Returns the type of an action from the type of its goals: `pkg/action/Do` from
/// `pkg/msg/DoActionGoal`.
pub fn action_type(goal: &TypeName) -> Option<TypeName> {
    let (package, name) = goal.as_str().strip_suffix(GOAL)?.split_once("/msg/")?;
    TypeName::parse(&format!("{package}/action/{name}")).ok()
}

#[cfg(test)]
#[path = "../../tests/unit/config/action_topic.rs"]
mod tests;
