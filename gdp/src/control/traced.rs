//! What a switch answers to a probe that ended at it: types only.

use gdp_wire::Name;
use serde::{Deserialize, Serialize};

/// Switches of other domains that an answer lists, at most.
pub const MAX_BEYOND: usize = 16;

/// A probe ended at a switch. Believed only by who knows its cookie, and as a hint: switches of the domain pass it on.
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
    /// By links into other domains: the domain, and its switch at the other end; [`MAX_BEYOND`] of them at most. What lies behind these is hidden.
    pub beyond: Vec<(Name, Name)>,
}
