//! The roster of a topic: its message type, and its ROS publishers with the QoS that each offers. A
//! proxy sends the roster sealed under the name of the topic, so only readers of the topic can read
//! it. Each reader's proxy mirrors the roster: it creates one publisher in its ROS graph for each
//! that is listed.
//!
//! The writer pins the roster, so that every reader receives it before any latched message. The
//! writer sends it again every [`REFRESH`]. A reader that receives nothing from a writer for
//! [`LEASE`] drops all its publishers. The [`origin`] of a message is the number of its publisher.

mod incoming;
mod outgoing;

use std::time::Duration;

use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_e2e::seal::Encoding;
use serde::{Deserialize, Serialize};

pub use incoming::{Change, Incoming, RosterEvent};
pub use outgoing::{Outgoing, single};

/// Encoding number of a message that is a roster.
pub const ROSTER: Encoding = Encoding::Other(0x4752);

/// Interval between two rosters if nothing changes.
pub const REFRESH: Duration = Duration::from_secs(3);

/// Time after which a roster expires. It exceeds the lease of a DDS participant. So the publishers
/// of a robot that moves between two networks stay, and retransmitted messages still find them.
pub const LEASE: Duration = Duration::from_secs(30);

/// Shortest lease that a publisher's QoS can cause.
pub const MIN_LEASE: Duration = Duration::from_secs(1);

/// Maximum number of publishers of a topic in one ROS graph. Further publishers get no number.
pub const MAX_WRITERS: usize = 512;

/// Maximum size of a definition with all nested types, in bytes.
pub const MAX_DEFINITION: usize = 256 << 10;

const MAX_ROSTER: usize = MAX_DEFINITION + MAX_WRITERS * 512;
const MAX_KIND: usize = 256;
const MAX_HASH: usize = 32;
/// Maximum size of a node's full name in bytes.
pub const MAX_NODE: usize = 255;
const VERSION: u8 = 3;

/// The type and the publishers of a topic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roster {
    version: u8,
    pub kind: Kind,
    /// The definition of the type and of all nested types, concatenated as the dialect does it. It
    /// is `None` in a brief roster, and if the proxy does not know the definition.
    pub definition: Option<String>,
    /// The publishers, in ascending order of their numbers.
    pub writers: Vec<Writer>,
}

/// A message type in the ROS version of its publishers.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kind {
    pub dialect: Dialect,
    /// `std_msgs/String` in ROS 1, `std_msgs/msg/String` in ROS 2.
    pub name: String,
    /// The MD5 sum of ROS 1 or the RIHS01 hash of ROS 2. It is empty if unknown.
    #[serde(with = "gdp_core::cbor::bytes")]
    pub hash: Vec<u8>,
}

impl Kind {
    /// Returns whether both types have the same layout, as far as known. Not every middleware
    /// announces hashes, so an unknown hash equals any other.
    pub fn agrees(&self, other: &Self) -> bool {
        let unknown = self.hash.is_empty() || other.hash.is_empty();
        (self.dialect, &self.name) == (other.dialect, &other.name) && (unknown || self.hash == other.hash)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dialect {
    Ros1,
    Ros2,
}

/// A ROS publisher.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Writer {
    /// The number of the publisher. It is never reused within one session of the name.
    pub number: u32,
    /// The full name of the publisher's node, such as `/robot/driver`. It is empty if the graph
    /// does not tell it, or if it is longer than [`MAX_NODE`].
    pub node: String,
    /// Whether its lease of liveliness is in force. Publishers without a lease are always alive.
    pub alive: bool,
    pub offers: Offer,
}

/// The QoS that a publisher offers, in the terms of ROS 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Offer {
    pub reliable: bool,
    pub transient_local: bool,
    /// History depth in messages; 0 for "keep all".
    pub depth: u32,
    /// Deadline in nanoseconds; 0 for none.
    pub deadline_ns: u64,
    /// Lifespan of a message in nanoseconds; 0 for unlimited.
    pub lifespan_ns: u64,
    /// Liveliness lease in nanoseconds; 0 for none.
    pub liveliness_ns: u64,
    /// Whether the publisher itself asserts its liveliness, by topic.
    pub manual_liveliness: bool,
}

impl Offer {
    /// The default QoS of a publisher in ROS 2.
    pub const DEFAULT: Self = Self {
        reliable: true,
        transient_local: false,
        depth: 10,
        deadline_ns: 0,
        lifespan_ns: 0,
        liveliness_ns: 0,
        manual_liveliness: false,
    };

    /// Returns how long a reader keeps a publisher with this QoS while its proxy is silent. That is
    /// the shorter of its deadline and its liveliness lease, but at least [`MIN_LEASE`] and at most
    /// [`LEASE`]; without either it is [`LEASE`].
    pub fn lease(&self) -> Duration {
        let promises = [self.deadline_ns, self.liveliness_ns].into_iter().filter(|ns| *ns > 0).min();
        promises.map_or(LEASE, |ns| Duration::from_nanos(ns).clamp(MIN_LEASE, LEASE))
    }
}

/// The reason why a roster is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RosterError {
    #[error(transparent)]
    Cbor(#[from] CborError),
    #[error("a roster of version {0}, which this release does not know; update the proxy")]
    Version(u8),
    #[error("{what}: {got} where at most {most} are allowed")]
    TooMuch { what: &'static str, got: usize, most: usize },
    #[error("the publishers are not in the order of their numbers")]
    Order,
}

impl Roster {
    pub fn to_bytes(&self) -> Result<Vec<u8>, CborError> {
        cbor::encode(self)
    }

    /// Decodes a roster from another proxy.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, RosterError> {
        let roster: Self = cbor::decode(bytes, MAX_ROSTER)?;
        if roster.version != VERSION {
            return Err(RosterError::Version(roster.version));
        }
        let definition = roster.definition.as_ref().map_or(0, String::len);
        let bounds = [
            ("bytes of a type's name", roster.kind.name.len(), MAX_KIND),
            ("bytes of a type's hash", roster.kind.hash.len(), MAX_HASH),
            ("bytes of a definition", definition, MAX_DEFINITION),
            ("publishers", roster.writers.len(), MAX_WRITERS),
            (
                "bytes of a node's name",
                roster.writers.iter().map(|writer| writer.node.len()).max().unwrap_or(0),
                MAX_NODE,
            ),
        ];
        if let Some((what, got, most)) = bounds.into_iter().find(|(_, got, most)| got > most) {
            return Err(RosterError::TooMuch { what, got, most });
        }
        if !roster.writers.is_sorted_by(|a, b| a.number < b.number) {
            return Err(RosterError::Order);
        }
        Ok(roster)
    }
}

/// Returns the name of a node if it may be in a roster, or an empty text. Readers refuse longer
/// ones.
pub fn node_name(name: &str) -> &str {
    if name.len() > MAX_NODE { "" } else { name }
}

/// Returns the origin that a message of the publisher `number` carries.
pub fn origin(number: u32) -> [u8; 4] {
    number.to_be_bytes()
}

/// Returns the number of a message's publisher, or `None` if its writer does not number publishers.
pub fn number(origin: &[u8]) -> Option<u32> {
    origin.try_into().ok().map(u32::from_be_bytes)
}

#[cfg(test)]
#[path = "../../tests/unit/roster.rs"]
mod tests;
