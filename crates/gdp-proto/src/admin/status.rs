//! The daemon as it sees itself: `gdp-ctl status`.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::links::{Counts, GraceLink, LinkStatus};
use super::words::{RefusedThing, TierKind, TierState};

/// Whose switch answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HelloReply {
    /// The switch.
    pub name: Name,
    /// Where the daemon takes links over UDP, if it does.
    pub udp: Option<SocketAddr>,
}

/// What `gdp-ctl status` shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StatusReply {
    /// The switch.
    pub name: Name,
    /// `xdp-native`, `xdp-generic`, `dpdk`, `userspace`, or `mixed` where interfaces differ.
    pub data_plane: String,
    pub data_plane_reason: String,
    pub interfaces: Vec<InterfaceStatus>,
    /// Of each worker of DPDK.
    pub dpdk_processor_time_us: Vec<u64>,
    /// Where the daemon takes links over UDP, if it does.
    pub udp: Option<SocketAddr>,
    /// By id.
    pub links: Vec<LinkStatus>,
    /// Links whose peers fell silent or have a newer link, or that an earlier daemon left; by id.
    pub links_in_grace: Vec<GraceLink>,
    pub handshakes: Handshakes,
    /// Refused links and registrations of the last minute, at most 64; the latest first.
    pub refused: Vec<RecentRefusal>,
    /// All refusals since the daemon started: links and registrations, by code.
    pub refused_total: BTreeMap<String, Counts>,
    /// Of all data planes together.
    pub counters: Counts,
    /// Each counter by data plane: `kernel` or `dpdk`, and `userspace`.
    pub counters_by_plane: BTreeMap<String, Counts>,
    /// The names with the most frames, by samples.
    pub busiest: Vec<BusyName>,
    pub fib: FibStatus,
    pub topology: Reached,
    /// None if the RIB is elsewhere.
    pub rib: Option<RibStatus>,
    pub domain: Option<DomainStatus>,
    pub control: ControlStatus,
    /// The neighbouring domains; none if the RIB is elsewhere or has no domain.
    pub tiers: Option<Vec<TierStatus>>,
    pub warnings: Vec<Warning>,
    pub errors: Vec<String>,
}

/// What a peer was refused in the last minute.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RecentRefusal {
    pub peer: Name,
    pub what: RefusedThing,
    /// The latest reason.
    pub reason: String,
    pub count: u32,
    /// Time since the latest one.
    pub age_s: u64,
}

/// A network interface that the switch uses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InterfaceStatus {
    pub interface: String,
    /// `xdp-native`, `xdp-generic`, `dpdk` or `userspace`.
    pub data_plane: String,
    pub reason: String,
    /// Frames that the interface did not take after a redirect.
    pub redirect_lost: u64,
    /// What the device itself counts, where DPDK drives it.
    pub device: Option<DeviceStatus>,
    pub mtu: Option<u32>,
    pub addresses: Option<Vec<String>>,
    /// Resolved stations: IP address and MAC address.
    pub stations: Option<Vec<(String, String)>>,
}

/// Packets that a network device counts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DeviceStatus {
    pub received: u64,
    pub sent: u64,
    /// Arrived, and were lost in the device.
    pub missed: u64,
    /// Were passed to the device, and did not leave.
    pub failed: u64,
}

/// Handshakes of peers that dialled and got no link.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Handshakes {
    /// Had to prove their addresses first.
    pub challenged: u64,
    /// Ignored: too many were under way.
    pub refused: u64,
    /// Ended unfinished for newer ones.
    pub displaced: u64,
    /// Not finished in time, or in error.
    pub failed: u64,
}

/// A name with many frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BusyName {
    pub name: Name,
    /// Estimated from samples.
    pub frames: u64,
}

/// What the switch forwards by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FibStatus {
    pub names: usize,
    /// Of the last push of the RIB.
    pub generation: u64,
    /// Index of the switch's own egress bit, once it has one.
    pub own_bit: Option<u8>,
}

/// Switches of the domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Reached {
    pub switches: usize,
    /// Those with a path from here, this one among them.
    pub reached: usize,
}

/// What the RIB here knows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RibStatus {
    pub names: usize,
    pub switches: usize,
}

/// The switch's membership in a domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DomainStatus {
    pub name: Name,
    pub role: Option<String>,
    /// When the membership ends, in Unix seconds.
    pub not_after: Option<u64>,
    /// Why the membership does not hold.
    pub error: Option<String>,
    pub members_only: bool,
    pub invitations_used: usize,
    pub revocations: Vec<DomainRevocation>,
}

/// The newest revocation that is known of a domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DomainRevocation {
    pub domain: Name,
    pub number: u64,
}

/// Where the RIB is, and whether it can be asked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControlStatus {
    /// The RIB's switch.
    pub rib: Option<Name>,
    /// The neighbour that leads there.
    pub next: Option<Name>,
    /// Pushes refused of RIBs whose terms were over.
    pub fenced: u64,
    pub ready: bool,
    /// Why it is not ready.
    pub reason: Option<String>,
}

/// A neighbouring domain, as this domain's RIB sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TierStatus {
    pub domain: Name,
    pub kind: TierKind,
    pub state: TierState,
    pub reason: Option<String>,
    pub entries_in: usize,
    pub entries_out: usize,
    /// Entries by why they were refused.
    pub refused: Counts,
}

/// What looks wrong though nothing has failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Warning {
    /// An endpoint may send to so many names with readers, and has sent nothing for a while.
    Silent { entity: Name, names: usize, for_s: u64 },
    /// Names with readers or callers that nobody publishes or serves; the first of them.
    #[serde(rename = "not_served")]
    NotServed { count: usize, names: Vec<Name> },
    /// The switch is of no domain, so every endpoint that reaches it gets a link.
    Open,
    /// The MTU of an interface is too small for links.
    #[serde(rename = "small_mtu")]
    SmallMtu {
        interface: String,
        /// In bytes, like `needed`.
        mtu: u32,
        needed: u32,
    },
}

impl Warning {
    /// All kinds, as [`Self::kind`] returns them.
    pub const KINDS: [&'static str; 4] = ["silent", "not_served", "open", "small_mtu"];

    /// Returns the word for the kind of warning.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Silent { .. } => "silent",
            Self::NotServed { .. } => "not_served",
            Self::Open => "open",
            Self::SmallMtu { .. } => "small_mtu",
        }
    }
}
