//! Where names are and how far that is: replies to what `gdp-ctl ping` and `trace` ask.

use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::words::Outcome;

/// Where a name is, as the switch that answers sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LocateReply {
    pub name: Name,
    /// The switch that answers.
    pub own: Name,
    /// The name has a link with that switch.
    pub near: bool,
    /// The egress switches of the name.
    pub egress: Vec<Name>,
    /// What the switch that answers delivers the name to.
    pub end: PathEnd,
}

/// What an egress switch, or a domain, delivers a name to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PathEnd {
    /// Links to local endpoints.
    pub links: u32,
    pub beyond: Vec<Beyond>,
}

/// A link into another domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Beyond {
    pub domain: Name,
    /// Its switch at the other end.
    pub switch: Name,
}

/// The answer of a neighbour's data plane, if there was one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EchoReply {
    pub rtt_us: Option<u64>,
}

/// The answer to a probe, if there was one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProbeReply {
    /// Where the probe ended.
    pub switch: Option<Name>,
    pub rtt_us: Option<u64>,
    /// None if the switch is not an egress switch of the name.
    pub end: Option<PathEnd>,
}

/// The domains on the path behind a border, each before those behind it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BeyondReply {
    pub domains: Vec<DomainHop>,
}

/// A domain that a name crosses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DomainHop {
    /// Links between domains from the border that was asked.
    pub depth: u8,
    pub domain: Name,
    /// Its switch where the name enters.
    pub switch: Name,
    /// From the border before it to that switch and back.
    pub rtt_us: Option<u64>,
    pub outcome: Outcome,
    /// Why it was refused.
    pub reason: Option<String>,
    /// Only of a domain that was traced.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inside: Option<DomainInside>,
}

/// What a domain says of its part of the path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DomainInside {
    /// Links to endpoints.
    pub links: u32,
    /// To the slowest egress switch and back; none if not all have answered.
    pub rtt_us: Option<u64>,
    /// None if the domain hides its switches.
    pub hops: Option<Vec<InsideHop>>,
}

/// A switch inside of a domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InsideHop {
    /// Switches from where the name enters.
    pub hop: u8,
    /// None: no answer.
    pub switch: Option<Name>,
    pub rtt_us: Option<u64>,
}
