//! Actions are no more than three services and two topics beneath `NAME/_action` (design.ros2.org,
//! "Actions"): their names and types, and the QoS that rclcpp and rclpy give them.

use super::{Depth, Durability, Qos, Reliability, TopicName, TypeName};
use gdp_ros::names::NameError;

/// The parts of one action.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Action {
    pub send_goal: (TopicName, TypeName),
    pub cancel_goal: (TopicName, TypeName),
    pub get_result: (TopicName, TypeName),
    pub feedback: (TopicName, TypeName),
    pub status: (TopicName, TypeName),
}

impl Action {
    /// `/fibonacci`, `example_interfaces/action/Fibonacci`. Fails if a name gets too long for DDS.
    pub fn new(name: &TopicName, kind: &TypeName) -> Result<Self, NameError> {
        let part = |rest: &str, kind| Ok((name.join(&format!("_action/{rest}"))?, kind));
        Ok(Self {
            send_goal: part("send_goal", kind.with(SEND_GOAL))?,
            cancel_goal: part("cancel_goal", TypeName::parse("action_msgs/srv/CancelGoal")?)?,
            get_result: part("get_result", kind.with("_GetResult"))?,
            feedback: part("feedback", kind.with("_FeedbackMessage"))?,
            status: part("status", TypeName::parse("action_msgs/msg/GoalStatusArray")?)?,
        })
    }

    /// Of the feedback topic: an observer that comes late has missed what was before.
    pub fn feedback_qos() -> Qos {
        Qos::default()
    }

    /// Of the status topic: a late observer learns of the goals that are there.
    pub fn status_qos() -> Qos {
        Qos { reliability: Reliability::Reliable, durability: Durability::TransientLocal, depth: Depth::ONE }
    }

    /// Which action a name beneath `_action` belongs to, and as what: `/fibonacci`, `send_goal`.
    pub(super) fn part_of(name: &TopicName) -> Option<(TopicName, &str)> {
        let (action, part) = name.as_str().rsplit_once("/_action/")?;
        Some((TopicName::parse(action).ok()?, part))
    }

    /// The action's type, from that of its service `send_goal`.
    pub(super) fn kind_of(send_goal: &TypeName) -> Option<TypeName> {
        send_goal.without(SEND_GOAL)
    }
}

const SEND_GOAL: &str = "_SendGoal";

#[cfg(test)]
#[path = "../../tests/unit/ros2/action.rs"]
mod tests;
