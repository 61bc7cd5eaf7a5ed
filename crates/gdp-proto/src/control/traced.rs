//! Answers to probes, sent by the switch where a probe ended, and the requests of borders to trace
//! a name into other domains: types only.

use gdp_wire::Name;
use serde::{Deserialize, Serialize};

/// Maximum number of switches of other domains in an answer.
pub const MAX_BEYOND: usize = 16;

/// Report that a probe ended at a switch. Only the sender of the probe knows its cookie. Other
/// switches of the domain forward the report, so it is only a hint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traced {
    /// Random cookie of the probe.
    pub cookie: u64,
    /// Switch at which the probe ended.
    pub switch: Name,
    /// Receivers of the name, if this switch is an egress switch for it.
    pub end: Option<TracedEnd>,
}

/// Receivers of a name at an egress switch. Endpoints are counted, not named.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedEnd {
    /// Number of links to local endpoints.
    pub links: u32,
    /// Links into other domains, each with the domain and its switch at the other end, at most
    /// [`MAX_BEYOND`]. [`TraceOn`] traces beyond them.
    pub beyond: Vec<(Name, Name)>,
}

/// Maximum number of domains in the answer to a [`TraceOn`].
pub const MAX_TRACED_DOMAINS: usize = 32;

/// Maximum number of switches within domains in the answer, in all domains together.
pub const MAX_TRACED_SWITCHES: usize = 256;

/// Request to trace a name onward in another domain, and in those behind it.
/// [`Response::TracedOn`](super::Response::TracedOn) answers it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TraceOn {
    pub leg: TraceLeg,
    pub name: Name,
    /// Domains that frames for the name have crossed: the tracing domain first, the asking one
    /// last, 1 to [`MAX_PATH`](super::MAX_PATH). No domain is entered twice.
    pub path: Vec<Name>,
    /// Time to wait for the answer, in milliseconds.
    pub within_ms: u32,
}

/// Leg of a [`TraceOn`] request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TraceLeg {
    /// Within the asking domain, toward the border switch that has a link to switch `peer` of
    /// `domain`.
    Out { domain: Name, peer: Name },
    /// On the link between the domains.
    Across,
}

/// Domain on the path of a name. What a domain states about itself and the domains behind it is not
/// verified.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedDomain {
    /// Number of links between domains, counted from the asked border: 1 for the domain at the
    /// other end of its link. A domain behind another one follows it and is one deeper.
    pub depth: u8,
    pub domain: Name,
    /// Switch of the domain by which the trace enters it.
    pub entry: Name,
    /// Round-trip time in µs between the border before it and that switch, in their data planes.
    /// `None` if there was no answer.
    pub rtt_us: Option<u64>,
    pub crossing: Crossing,
}

/// Outcome of a trace in a domain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Crossing {
    /// All or some of the domain's egress switches for the name have answered.
    Traced {
        /// Number of links to endpoints that receive the name.
        links: u32,
        /// Round-trip time in µs from the entry to the slowest egress switch. `None` unless all
        /// have answered.
        time_us: Option<u64>,
        /// Switches behind the entry, unless the domain hides them.
        switches: Option<Vec<TracedSwitch>>,
    },
    /// No answer arrived in time.
    Unanswered,
    /// The domain was not traced, for this reason.
    Refused { reason: String },
    /// The frames have crossed the domain before.
    Loop,
    /// The frames have crossed [`MAX_PATH`](super::MAX_PATH) domains before this one.
    TooFar,
}

/// Switch within a domain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedSwitch {
    /// Number of hops from the entry: 1 for the next switch. It restarts with the path to each
    /// egress switch.
    pub hop: u8,
    /// Name of the switch. `None` if it has not answered.
    pub switch: Option<Name>,
    /// Round-trip time in µs from the entry.
    pub rtt_us: Option<u64>,
}
