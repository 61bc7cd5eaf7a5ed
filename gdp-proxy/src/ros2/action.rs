//! An action consists of three services and two topics beneath `NAME/_action` (design.ros2.org,
//! "Actions"). This module has their names and types, and the QoS that rclcpp and rclpy use.

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
    /// Returns the parts of an action, such as `/fibonacci` of type
    /// `example_interfaces/action/Fibonacci`. Fails if a name is too long for DDS.
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

    /// Returns the QoS of the feedback topic. A late subscriber does not receive earlier feedback.
    pub fn feedback_qos() -> Qos {
        Qos::default()
    }

    /// Returns the QoS of the status topic. A late subscriber receives the state of the present
    /// goals.
    pub fn status_qos() -> Qos {
        Qos { reliability: Reliability::Reliable, durability: Durability::TransientLocal, depth: Depth::ONE }
    }

    /// Returns the action of a name beneath `_action`, and its part: `/fibonacci`, `send_goal`.
    pub(super) fn part_of(name: &TopicName) -> Option<(TopicName, &str)> {
        let (action, part) = name.as_str().rsplit_once("/_action/")?;
        Some((TopicName::parse(action).ok()?, part))
    }

    /// Returns the action's type from the type of its service `send_goal`.
    pub(super) fn kind_of(send_goal: &TypeName) -> Option<TypeName> {
        send_goal.without(SEND_GOAL)
    }
}

const SEND_GOAL: &str = "_SendGoal";

#[cfg(test)]
#[path = "../../tests/unit/ros2/action.rs"]
mod tests;
