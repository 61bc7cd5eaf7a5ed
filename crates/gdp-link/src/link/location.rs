//! The properties of a port that a link needs.

use std::net::{IpAddr, UdpSocket};

use crate::port::HostPair;
use std::net::{Ipv4Addr, SocketAddr};

/// The properties of a link's port.
#[derive(Clone, Copy, Debug)]
pub enum LinkLocation {
    Ethernet {
        ifindex: u32,
        vlan: u16,
        local_mac: [u8; 6],
        peer_mac: [u8; 6],
    },
    /// `bound` is the address of the port's socket, possibly the unspecified address. `pair` gives
    /// the addresses of frames if they differ from those of QUIC.
    Udp {
        bound: SocketAddr,
        pair: Option<PairEnd>,
    },
}

impl LinkLocation {
    /// Returns whether a peer's address belongs to this host. The kernel then uses the same address
    /// as the source.
    pub fn leads_to_this_host(self, peer: SocketAddr) -> bool {
        matches!(self, Self::Udp { bound, .. } if udp_source(bound.ip(), peer) == peer.ip().to_canonical())
    }

    pub fn by(self, end: PairEnd) -> Self {
        match self {
            Self::Udp { bound, .. } => Self::Udp { bound, pair: Some(end) },
            ethernet => ethernet,
        }
    }
}

/// One side's view of a [`HostPair`].
#[derive(Clone, Copy, Debug)]
pub struct PairEnd {
    /// The endpoint does not know this address or the MAC addresses; its kernel does.
    pub local_ip: Ipv4Addr,
    pub local_mac: [u8; 6],
    pub peer_ip: Ipv4Addr,
    pub peer_mac: [u8; 6],
}

impl PairEnd {
    pub fn toward(switch: Ipv4Addr) -> Self {
        Self { local_ip: Ipv4Addr::UNSPECIFIED, local_mac: [0; 6], peer_ip: switch, peer_mac: [0; 6] }
    }

    pub fn of_switch(pair: &HostPair) -> Self {
        let HostPair { switch_ip, switch_mac, host_ip, host_mac, .. } = *pair;
        Self { local_ip: switch_ip, local_mac: switch_mac, peer_ip: host_ip, peer_mac: host_mac }
    }
}

/// Returns the source address of a socket bound to `bound` for packets to `peer`. Returns the
/// unspecified address if there is no route.
pub fn udp_source(bound: IpAddr, peer: SocketAddr) -> IpAddr {
    if !bound.is_unspecified() {
        return bound.to_canonical();
    }
    // Connecting a UDP socket sends nothing; the kernel only looks up the route.
    let ask = || {
        let socket = UdpSocket::bind((bound, 0))?;
        socket.connect(peer)?;
        socket.local_addr()
    };
    ask().map_or(bound, |local| local.ip().to_canonical())
}
