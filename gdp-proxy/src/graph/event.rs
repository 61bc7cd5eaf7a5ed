//! Events that a ROS graph sends to the routes, and its errors.

use std::sync::Arc;

use crate::ros2::RosError;
use bytes::Bytes;
use gdp_ros::roster::{Kind, Offer};
use gdp_ros::types::TypeError;

/// Errors of a ROS graph.
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
    #[error("Zenoh: {0}")]
    Zenoh(String),
    #[error(
        "the hash of {0} is not known, and nodes with rmw_zenoh compare it; give the proxy its definition (`definitions`)"
    )]
    NoHash(String),
    #[error("this gdp-proxy was built without graphs of rmw_zenoh; build it with `--features zenoh`")]
    WithoutZenoh,
    #[error("the ROS graph was left")]
    Left,
}

/// Prefix of the names of all proxies' ROS nodes. Proxies ignore each other's publishers, because
/// their messages come from the fabric.
pub const NODE: &str = "gdp_proxy_";

/// Identifier of a publisher of a topic, unique as long as the publisher exists.
pub type Key = u128;

/// An event of a topic that is read.
pub enum Event {
    /// A publisher appeared, or changed its type or QoS.
    Joined {
        key: Key,
        kind: Kind,
        /// The full name of its node, or an empty text.
        node: Arc<str>,
        offers: Offer,
    },
    /// A publisher is not read.
    Incompatible {
        key: Key,
        why: Incompatibility,
    },
    Left(Key),
    /// The lease of a publisher's liveliness has ended, or the publisher is alive again.
    Liveliness {
        key: Key,
        alive: bool,
    },
    Message(Arrived),
    /// A message that cannot be carried, with the reason.
    Unreadable(String),
}

/// The reason why a publisher is not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Incompatibility {
    #[error("incompatible QoS: `qos` asks for more than it offers in {0}")]
    Qos(&'static str),
    /// DDS does not match it with a reader of a topic without keys.
    #[error("its type has key fields (`@key`), and topics with keys are not carried")]
    Keyed,
}

/// A message of a publisher that has joined. `from` is `None` if its publisher is unknown.
pub struct Arrived {
    pub from: Option<Key>,
    pub bytes: Bytes,
    /// Time of the write on the publisher's clock in Unix nanoseconds, if it is known.
    pub written_ns: Option<u64>,
    /// Number of messages of the same publisher that were lost just before this one.
    pub lost: u64,
}

/// Takes a message on the graph's receiving thread and returns true, or leaves it to
/// [`Reader::next`](super::Reader::next).
pub type ArrivalSink = Arc<dyn Fn(&Arrived) -> bool + Send + Sync>;

/// Reasons for which a message was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    #[error("not a CDR encapsulation that ROS 2 uses")]
    Malformed,
    #[error("the sockets of this host do not take messages as fast as they come")]
    Stalled,
    #[error("{0}")]
    Failed(String),
}
