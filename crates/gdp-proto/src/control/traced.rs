//! What a switch answers to a probe that ended at it, and what borders ask each other to trace a
//! name into other domains: types only.

use gdp_wire::Name;
use serde::{Deserialize, Serialize};

/// Switches of other domains that an answer lists, at most.
pub const MAX_BEYOND: usize = 16;

/// A probe ended at a switch. Believed only by who knows its cookie, and as a hint: switches of the
/// domain pass it on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traced {
    /// Random, of the probe.
    pub cookie: u64,
    /// The switch at which the probe ended.
    pub switch: Name,
    /// If that is where the name leaves the switches of the domain, what it would be delivered to.
    pub end: Option<TracedEnd>,
}

/// What an egress switch delivers a name to. Endpoints are counted, not named.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedEnd {
    /// Links to local endpoints.
    pub links: u32,
    /// By links into other domains: the domain, and its switch at the other end; [`MAX_BEYOND`] of
    /// them at most. What lies behind these, they are asked by [`TraceOn`].
    pub beyond: Vec<(Name, Name)>,
}

/// Domains that the answer to a [`TraceOn`] lists, at most.
pub const MAX_TRACED_DOMAINS: usize = 32;

/// Switches inside of domains that it lists, at most, in all of these together.
pub const MAX_TRACED_SWITCHES: usize = 256;

/// A request to trace a name on in another domain, and in those behind it. Answered with
/// [`Response::TracedOn`](super::Response::TracedOn).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TraceOn {
    pub leg: TraceLeg,
    pub name: Name,
    /// The domains that frames for the name have crossed before, the first that of who traces and
    /// the last that of who asks: 1 to [`MAX_PATH`](super::MAX_PATH). No domain is entered twice.
    pub path: Vec<Name>,
    /// Milliseconds for which the answer is waited for.
    pub within_ms: u32,
}

/// How far a [`TraceOn`] has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TraceLeg {
    /// Within its own domain: for the border switch that has a link to this one of this domain.
    Out { domain: Name, peer: Name },
    /// On that link.
    Across,
}

/// A domain on the way to a name. What a domain says of itself and of those behind it is its word,
/// and no more.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedDomain {
    /// Links between domains from the border that was asked: 1 for the domain at the other end of
    /// that border's link. A domain that is behind another follows it, one deeper.
    pub depth: u8,
    pub domain: Name,
    /// Its switch at the link by which it is entered.
    pub entry: Name,
    /// µs from the border before it to that switch and back, in their data planes; none: there was
    /// no answer.
    pub rtt_us: Option<u64>,
    pub crossing: Crossing,
}

/// What became of a trace in a domain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Crossing {
    /// Its egress switches for the name have answered, or some of them.
    Traced {
        /// Links to its endpoints that the name is delivered to.
        links: u32,
        /// µs from the entry to the slowest of the egress switches and back; none: not all have
        /// answered.
        time_us: Option<u64>,
        /// The switches behind the entry, unless the domain hides them.
        switches: Option<Vec<TracedSwitch>>,
    },
    /// Nobody has answered in time.
    Unanswered,
    /// It was not traced, for this reason.
    Refused { reason: String },
    /// The frames have crossed the domain before.
    Loop,
    /// They have crossed [`MAX_PATH`](super::MAX_PATH) domains before it.
    TooFar,
}

/// A switch inside of a domain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedSwitch {
    /// Switches from the entry: 1 for the next one. Begins anew with the way to each egress switch.
    pub hop: u8,
    /// None: it has not answered.
    pub switch: Option<Name>,
    /// µs from the entry to it and back.
    pub rtt_us: Option<u64>,
}
