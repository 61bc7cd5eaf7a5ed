//! The address of the other end of a link.

use std::fmt;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};

use gdp_core::mac::DisplayMac;

/// The address that a link's frames are sent to. For arriving frames it is only a hint: the id and
/// the tag identify their link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LinkAddr {
    /// A station on the segment of a local interface.
    Ethernet { ifindex: u32, mac: [u8; 6] },
    /// IPv4 or IPv6; an IPv4 address is never in its IPv6-mapped form.
    Udp(SocketAddr),
}

impl LinkAddr {
    /// Returns a UDP address, with an IPv4-mapped IPv6 address converted to IPv4.
    pub fn udp(addr: SocketAddr) -> Self {
        Self::Udp(SocketAddr::new(addr.ip().to_canonical(), addr.port()))
    }
}

impl fmt::Display for LinkAddr {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ethernet { ifindex, mac } => write!(f, "eth:{ifindex}/{}", DisplayMac(*mac)),
            Self::Udp(addr) => write!(f, "udp:{addr}"),
        }
    }
}

/// Encodes a MAC address as fd47::MAC, port 1, because quinn only supports socket addresses.
pub(super) fn mac_to_socket(mac: [u8; 6]) -> SocketAddr {
    let mut octets = [0; 16];
    octets[..2].copy_from_slice(&[0xfd, 0x47]);
    octets[10..].copy_from_slice(&mac);
    SocketAddr::new(Ipv6Addr::from(octets).into(), 1)
}

/// Returns the MAC address in a socket address that [`mac_to_socket`] made.
pub(super) fn socket_to_mac(addr: &SocketAddr) -> [u8; 6] {
    let IpAddr::V6(ip) = addr.ip() else { return [0; 6] };
    let mut mac = [0; 6];
    mac.copy_from_slice(&ip.octets()[10..]);
    mac
}

#[cfg(test)]
#[path = "../../tests/unit/port/addr.rs"]
mod tests;
