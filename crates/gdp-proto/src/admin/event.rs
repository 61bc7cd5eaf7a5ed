//! What happens at a switch: `gdp-ctl monitor`.

use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::control::RefusalCode;

use super::words::{PeerRelationship, PeerRole};

/// Something that happened, and when.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TimedEvent {
    /// Unix time in nanoseconds.
    pub at: u64,
    #[serde(flatten)]
    pub event: Event,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    LinkUp {
        peer: Name,
        role: PeerRole,
        relationship: PeerRelationship,
        via: String,
        address: String,
    },
    LinkDown {
        peer: Name,
        reason: String,
    },
    /// A peer, or this side, does not want the link; or nobody answers.
    LinkRefused {
        peer: Name,
        via: String,
        reason: String,
    },
    /// An attachment, an advertisement or a subscription of an entity was refused.
    RegistrationRefused {
        entity: Name,
        code: RefusalCode,
        reason: String,
    },
    /// Something that only attacks and broken peers cause has happened so often since the last
    /// event of its kind.
    Suspicious {
        /// A counter of dropped frames, or `handshakes`.
        what: String,
        count: u64,
        /// The peer over whose link most of the frames came, if its key authenticates them.
        peer: Option<Name>,
    },
    Attached {
        entity: Name,
    },
    Detached {
        entity: Name,
    },
    /// The RIB has changed so many routes of this switch.
    Routes {
        generation: u64,
        changes: usize,
    },
    /// Paths have changed; `reached`: switches with a path from here, this one among them.
    Topology {
        switches: usize,
        reached: usize,
    },
    /// The RIB here knows so many names and switches now.
    Rib {
        names: usize,
        switches: usize,
    },
    /// The listener was too slow for so many events.
    Missed {
        events: u64,
    },
}
