//! Links and peers of a switch: `gdp-ctl link list`, `peer list`.

use std::collections::BTreeMap;

use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::words::{PeerLink, PeerRelationship, PeerRole};

/// Frames by counter.
pub type Counts = BTreeMap<String, u64>;

/// What `gdp-ctl link list` shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LinksReply {
    /// By id.
    pub links: Vec<LinkStatus>,
}

/// A live link.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LinkStatus {
    pub peer: Name,
    pub role: PeerRole,
    /// Which of the peer's parallel links this is.
    pub lane: u8,
    pub relationship: PeerRelationship,
    /// The peer's domain, if that is another one.
    pub domain: Option<Name>,
    /// When the peer's admission ends, in Unix seconds; none if it does not.
    pub admitted_until: Option<u64>,
    /// The interface, or the local address.
    pub via: String,
    pub address: String,
    pub id: u32,
    pub mtu: u32,
    pub key_generations: KeyGenerations,
    /// Of a path over this link; none to endpoints.
    pub cost: Option<u32>,
    pub rtt_us: u64,
    pub age_s: u64,
    /// Frames of this switch that the peer refused, by code.
    pub errors_received: Counts,
    /// What became of frames that came in, by counter; none where the kernel cannot be asked.
    pub arrivals: Option<Counts>,
    pub traces_refused: u64,
    /// Frames.
    pub sent: u64,
    pub carrier: bool,
    /// The peer's data plane answers echoes. Frames avoid the link while it does not.
    pub answers: bool,
    /// The data plane that sends on it: `kernel`, `dpdk` or `userspace`.
    pub plane: String,
}

/// How often each direction of a link has changed its key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct KeyGenerations {
    pub rx: u64,
    pub tx: u64,
}

/// A link whose peer fell silent or has a newer link, or that an earlier daemon left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GraceLink {
    pub peer: Name,
    pub role: PeerRole,
    pub address: String,
    pub id: u32,
    /// The peer's data plane answers echoes. Frames use the link only while it does.
    pub answers: bool,
    /// Frames of this switch that the peer refused, by code.
    pub errors_received: Counts,
}

/// What `gdp-ctl peer list` shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PeersReply {
    /// The domain of this switch, if it has one.
    pub domain: Option<Name>,
    /// By name.
    pub peers: Vec<PeerStatus>,
}

/// A switch or domain that this switch has, should have, or was refused a link with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PeerStatus {
    pub peer: Name,
    /// The configuration names it.
    pub listed: bool,
    pub role: Option<PeerRole>,
    pub domain: Option<Name>,
    pub relationship: Option<PeerRelationship>,
    /// What this domain lets the peer's do.
    pub rights_granted: Option<String>,
    /// What the peer's domain lets this one do.
    pub rights_received: Option<String>,
    /// When the relationship ends, in Unix seconds; none if it does not.
    pub until: Option<u64>,
    pub link: PeerLink,
    pub via: Option<String>,
    /// Why there is no link.
    pub reason: Option<String>,
    pub reason_age_s: Option<u64>,
}
