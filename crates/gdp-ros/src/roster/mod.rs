//! What a proxy tells of a topic beside its messages: of which type they are, and which ROS
//! publishers they come from, with the quality of service that each offers. It goes sealed like the
//! messages, under the same name, so that whoever may read these learns it and nobody else does.
//! Readers mirror it: each publisher has its counterpart in their ROS graph, for as long as it is
//! listed.
//!
//! A roster is pinned at the publisher of the name, so that every reader gets it before anything
//! latched. It is sent again every [`REFRESH`]; whom a roster is not heard of for [`LEASE`] is
//! gone, with all its publishers. A message says by its origin ([`origin`]) from which of the
//! publishers it is.

mod incoming;
mod outgoing;

use std::time::Duration;

use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_e2e::seal::Encoding;
use serde::{Deserialize, Serialize};

pub use incoming::{Change, Incoming, Taken};
pub use outgoing::{Announcement, Outgoing};

/// How a message is marked that is a roster.
pub const ROSTER: Encoding = Encoding::Other(0x4752);

/// How often a roster is sent, if nothing changes.
pub const REFRESH: Duration = Duration::from_secs(3);

/// For how long a roster holds: somewhat longer than DDS waits for a participant that is not heard
/// of, so that a robot between two networks keeps its publishers, and what is repaired then finds
/// them.
pub const LEASE: Duration = Duration::from_secs(30);

/// The shortest lease that a publisher's promises make.
pub const MIN_LEASE: Duration = Duration::from_secs(1);

/// Publishers of a topic in one ROS graph. More are not told apart.
pub const MAX_WRITERS: usize = 512;

/// A definition with all that it contains, in bytes.
pub const MAX_DEFINITION: usize = 256 << 10;

const MAX_ROSTER: usize = MAX_DEFINITION + MAX_WRITERS * 256;
const MAX_KIND: usize = 256;
const MAX_HASH: usize = 32;
const VERSION: u8 = 2;

/// What is told of a topic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roster {
    version: u8,
    pub kind: Kind,
    /// The text that the type is defined by, of all types that it contains, as its dialect
    /// concatenates them. Left out when it is only said that everything is as before, or if the
    /// proxy does not know it.
    pub definition: Option<String>,
    /// By ascending number.
    pub writers: Vec<Writer>,
}

/// A message type, as the ROS version names it that the messages come from.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kind {
    pub dialect: Dialect,
    /// `std_msgs/String` of ROS 1, `std_msgs/msg/String` of ROS 2.
    pub name: String,
    /// The MD5 sum of ROS 1, or the RIHS01 hash of ROS 2; empty if it is not known.
    #[serde(with = "gdp_core::cbor::bytes")]
    pub hash: Vec<u8>,
}

impl Kind {
    /// Whether messages of both are laid out alike, as far as is known: not every middleware tells
    /// hashes.
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
    /// Never another's under the same session of the name.
    pub number: u32,
    pub offers: Offer,
}

/// What a publisher offers, in the terms of ROS 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Offer {
    pub reliable: bool,
    pub transient_local: bool,
    /// Messages that it keeps, if it keeps the last; 0 if it keeps all.
    pub depth: u32,
    /// Nanoseconds within which it promises a message; 0 for no promise.
    pub deadline_ns: u64,
    /// Nanoseconds after which a message is not delivered any more; 0 for never.
    pub lifespan_ns: u64,
    /// Nanoseconds within which it shows that it is alive; 0 for no promise.
    pub liveliness_ns: u64,
}

impl Offer {
    /// For how long a publisher that offers this is taken for there, if nothing is heard of its
    /// proxy: [`LEASE`], or as long as its promises hold.
    pub fn lease(&self) -> Duration {
        let promises = [self.deadline_ns, self.liveliness_ns].into_iter().filter(|ns| *ns > 0).min();
        promises.map_or(LEASE, |ns| Duration::from_nanos(ns).clamp(MIN_LEASE, LEASE))
    }
}

/// Why a roster is not taken.
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

    /// Reads what another proxy sent.
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

/// What a message carries that is from the publisher with this number.
pub fn origin(number: u32) -> [u8; 4] {
    number.to_be_bytes()
}

/// The number of the publisher that a message is from, if its writer tells publishers apart.
pub fn number(origin: &[u8]) -> Option<u32> {
    origin.try_into().ok().map(u32::from_be_bytes)
}

#[cfg(test)]
#[path = "../../tests/unit/roster.rs"]
mod tests;
