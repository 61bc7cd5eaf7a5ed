//! Questions of an endpoint to its switch, for people: the state of its attachment, and the path of
//! a name to which it may send. Types only.

use gdp_core::peer::MAX_LANES;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Maximum number of links in an [`AttachmentStatus`].
pub const MAX_STATED_LINKS: usize = MAX_LANES;

/// Maximum number of names in an [`AttachmentStatus`].
pub const MAX_STATED_NAMES: usize = 256;

/// A question of an endpoint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Inspection {
    /// The switch, and the endpoint's own links and names there.
    Status,
    /// The egress switches of a name to which the endpoint may send, or of the switch itself.
    Locate { name: Name },
    /// One probe for such a name, toward one of its egress switches, at most `hops` switches far.
    Probe { name: Name, egress: Name, hops: u8 },
}

/// The answer to an [`Inspection`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Inspected {
    Status(Box<AttachmentStatus>),
    Location(NameLocation),
    Probe(ProbeEnd),
}

/// A switch as it describes itself to an attached endpoint, with nothing of other endpoints.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AttachmentStatus {
    pub switch: Name,
    /// The release that the switch runs.
    pub release: String,
    /// The switch's domain.
    pub domain: Option<Name>,
    /// `xdp-native`, `xdp-generic`, `dpdk`, `userspace`, or `mixed` where interfaces differ.
    pub data_plane: String,
    /// Why the switch does not reach the RIB; none if it does.
    pub no_rib: Option<String>,
    /// The endpoint's own links, at most [`MAX_STATED_LINKS`].
    pub links: Vec<OwnLink>,
    /// The names that the endpoint sends to or receives here, at most [`MAX_STATED_NAMES`].
    pub names: Vec<OwnName>,
    /// Whether there are more names.
    pub truncated: bool,
}

/// A link of the endpoint, as the switch sees it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct OwnLink {
    /// Number of the link among the endpoint's.
    pub lane: u8,
    /// The endpoint's address.
    pub address: String,
    pub mtu: u32,
    pub rtt_us: u64,
    pub age_s: u64,
    /// Unix time until which the endpoint's credentials permit the link.
    pub admitted_until: Option<u64>,
}

/// A name that the endpoint uses at the switch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct OwnName {
    pub name: Name,
    /// The endpoint may send to the name.
    pub sends: bool,
    /// Frames for the name are delivered to the endpoint.
    pub receives: bool,
    /// Frames for the name are delivered to somebody.
    pub has_receivers: bool,
}

/// The egress switches of a name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NameLocation {
    pub egress: Vec<Name>,
    /// Number of links of the answering switch to endpoints that receive the name.
    pub links: u32,
}

/// The end of a probe.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProbeEnd {
    /// The switch where the probe ended; none without an answer.
    pub switch: Option<Name>,
    /// Number of that switch's links to endpoints that receive the name; none unless it is an
    /// egress switch of the name.
    pub links: Option<u32>,
}
