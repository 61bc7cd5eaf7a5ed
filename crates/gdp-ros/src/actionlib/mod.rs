//! The protocol of actions in ROS 1 (wiki.ros.org/actionlib/DetailedDescription), without I/O.
//!
//! A proxy is a client of a real server ([`GoalClient`]), or a server for real clients
//! ([`GoalServer`]). Both translate the goals to those of ROS 2, because proxies exchange these.
//! [`message`] reads and writes the parts of messages that all actions share.

mod client;
pub mod message;
mod server;

pub use client::{Accepted, GoalClient, GoalOutcome};
pub use server::{Ask, Ended, GoalServer, Taken};

/// The statuses of `actionlib_msgs/GoalStatus`.
pub mod status {
    pub const PENDING: u8 = 0;
    pub const ACTIVE: u8 = 1;
    pub const PREEMPTED: u8 = 2;
    pub const SUCCEEDED: u8 = 3;
    pub const ABORTED: u8 = 4;
    pub const REJECTED: u8 = 5;
    pub const PREEMPTING: u8 = 6;
    pub const RECALLING: u8 = 7;
    pub const RECALLED: u8 = 8;
    pub const LOST: u8 = 9;

    /// Returns the status with which a goal ends by its result. A server that sends a result with
    /// another status has aborted the goal, as far as clients can know.
    pub fn of_result(status: u8) -> u8 {
        if is_final(status) { status } else { ABORTED }
    }

    /// Returns whether the goal has ended.
    pub fn is_final(status: u8) -> bool {
        matches!(status, PREEMPTED | SUCCEEDED | ABORTED | REJECTED | RECALLED | LOST)
    }

    /// Returns the status of `action_msgs/msg/GoalStatus`. ROS 2 has no rejected or lost goals.
    pub fn to_ros2(status: u8) -> i8 {
        match status {
            PENDING => 1,
            ACTIVE => 2,
            PREEMPTING | RECALLING => 3,
            SUCCEEDED => 4,
            PREEMPTED | RECALLED => 5,
            _ => 6,
        }
    }

    /// Returns the status for one of `action_msgs/msg/GoalStatus`.
    pub fn of_ros2(status: i8) -> u8 {
        match status {
            1 => PENDING,
            2 => ACTIVE,
            3 => PREEMPTING,
            4 => SUCCEEDED,
            5 => PREEMPTED,
            _ => ABORTED,
        }
    }
}
