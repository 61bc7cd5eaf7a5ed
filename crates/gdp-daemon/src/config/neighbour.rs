//! The keys `neighbours` and `uplink`: switches to have links with.

use std::fmt;
use std::net::SocketAddr;

use gdp_core::link_target::LinkTarget;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Deserialize;

use super::listen::parse_tls_target;

/// A configured neighbour and the cost of its link. Without a cost, the round-trip time determines
/// it, see [`gdp_rib::topology::cost`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Neighbour {
    pub address: NeighbourAddress,
    pub cost: Option<u32>,
    /// Whether this side dials. Otherwise the side with the smaller name does.
    pub dial: bool,
    /// Whether the neighbour is a border of a parent domain, whose RIB is above this one's. The
    /// order of the list is the order of queries to parents.
    pub parent: bool,
    /// Where the neighbour is reached over TLS while it does not answer over UDP.
    pub tls: Option<LinkTarget>,
}

/// A neighbouring switch and its location.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NeighbourAddress {
    pub switch: Name,
    pub via: Via,
}

/// The path to a neighbour.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Via {
    /// The neighbour is on the segment of this interface, and discovery finds its address.
    Interface(String),
    Udp(SocketAddr),
    /// Inside TLS, by a tunnel to this address.
    Tls(LinkTarget),
}

impl Via {
    /// Returns whether both use the same interface, or both use UDP. A tunnel ends at UDP.
    pub fn same_port(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Interface(a), Self::Interface(b)) => a == b,
            (Self::Udp(_) | Self::Tls(_), Self::Udp(_) | Self::Tls(_)) => true,
            _ => false,
        }
    }
}

impl fmt::Display for Via {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Interface(name) => f.write_str(name),
            Self::Udp(addr) => write!(f, "udp {addr}"),
            Self::Tls(target) => write!(f, "{target}"),
        }
    }
}

/// A neighbouring switch, at an interface or at an address: one of the two.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NeighbourAddressEntry {
    /// The neighbour's name, 64 hex digits.
    pub switch: Name,
    /// The Ethernet interface that it is on.
    interface: Option<String>,
    /// Its address and port.
    #[schemars(with = "Option<String>")]
    udp: Option<SocketAddr>,
    /// Beside `udp`: where it is reached over TLS while UDP does not answer, such as `tls://HOST`
    /// or `wss://HOST:443`.
    tls: Option<String>,
    /// The cost of the link, at least 1. By default it follows from the round-trip time.
    pub cost: Option<u32>,
    /// Makes the link from this side, as with `tls`. Otherwise the switch with the smaller name
    /// does.
    #[serde(default)]
    dial: bool,
    /// The neighbour is a border of the domain above.
    #[serde(default)]
    parent: bool,
}

impl NeighbourAddressEntry {
    pub fn neighbour(self, key: &str) -> Result<Neighbour, String> {
        let cost = self.cost;
        if cost == Some(0) {
            return Err(format!("{key}: cost of {} is 0; the least is 1", self.switch));
        }
        let (dial, parent, tls) = (self.dial, self.parent, self.tls.as_deref());
        let tls = tls.map(|text| parse_tls_target(key, text)).transpose()?;
        if tls.is_some() && self.udp.is_none() {
            return Err(format!("{key}: tls of {} is used beside udp: ADDRESS:PORT", self.switch));
        }
        Ok(Neighbour { address: self.address(key)?, cost, dial: dial || tls.is_some(), parent, tls })
    }

    fn address(self, key: &str) -> Result<NeighbourAddress, String> {
        let via = match (self.interface, self.udp) {
            (Some(name), None) => Via::Interface(name),
            (None, Some(addr)) => Via::Udp(addr),
            _ => {
                let switch = self.switch;
                let reason = format!("{key}: {switch} needs either interface: NAME or udp: ADDRESS:PORT");
                return Err(reason);
            }
        };
        Ok(NeighbourAddress { switch: self.switch, via })
    }
}
