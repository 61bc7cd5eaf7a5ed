//! Events that a ROS graph sends to the routes, and its errors.

use crate::ros2::RosError;
use bytes::Bytes;
use gdp_ros::roster::{Kind, Offer};
use gdp_ros::types::TypeError;

/// What a graph refused to make.
#[derive(Debug, thiserror::Error)]
pub enum GraphError {
    #[error(transparent)]
    Ros1(#[from] gdp_ros1::NodeError),
    #[error(transparent)]
    Ros2(#[from] RosError),
    #[error(transparent)]
    Type(#[from] TypeError),
    #[error("the proxy publishes {topic} as {published} by now, and a node of ROS 1 has one type for a topic")]
    OtherType { topic: String, published: String },
    #[error("the ROS graph was left")]
    Left,
}

/// What the names of all proxies' ROS nodes begin with: they do not take from one another what came
/// from the fabric.
pub const NODE: &str = "gdp_proxy_";

/// What tells the publishers of a topic apart, as long as they live.
pub type Key = u128;

/// What happens to a topic that is read.
pub enum Event {
    /// A publisher is there, or offers something else than it did.
    Joined {
        key: Key,
        kind: Kind,
        offers: Offer,
    },
    /// A publisher is there that is not heard, because it offers less than the configuration asks
    /// for: in which policy.
    Incompatible {
        key: Key,
        policy: &'static str,
    },
    Left(Key),
    Message(Arrived),
    /// A message that cannot be carried, with the reason.
    Unreadable(String),
}

/// A message of a publisher that has joined, unless it cannot be told which.
pub struct Arrived {
    pub from: Option<Key>,
    pub bytes: Bytes,
    /// When its publisher wrote it, on its clock, in nanoseconds since 1970; if it said so.
    pub written_ns: Option<u64>,
    /// Messages of the same publisher that were lost on the way, just before this one.
    pub lost: u64,
}

/// Why a message was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    #[error("not a CDR encapsulation that ROS 2 uses")]
    Malformed,
    #[error("the sockets of this host do not take messages as fast as they come")]
    Stalled,
    #[error("{0}")]
    Failed(String),
}
