//! Frames as payload of UDP over IPv6, to peers that accept datagrams without a checksum (RFC
//! 6936). The userspace plane sends to other peers, because the program cannot compute the checksum
//! of every frame. See [`super::checksum`].
//!
//! Received packets are checked as in [`super::udp4`]. Packets with extension headers, including
//! fragments, go to the host.

use aya_ebpf::programs::XdpContext;
use gdp_wire::Carrier;
use gdp_wire::packet::{self, ETHERNET_LEN, IPV6, IPV6_LEN, UDP6_LEN};

use crate::carrier::ethernet::Ethernet;
use crate::carrier::frame::FrameLocation;
use crate::carrier::udp4::Udp;
use crate::local;
use crate::next_hop::NextHop;
use crate::packet::Packet;

type Ipv6 = packet::Ipv6<u16, u32>;

#[inline(always)]
pub fn find(packet: &Packet, length: usize) -> Option<FrameLocation> {
    let ip = packet.get::<Ipv6>(ETHERNET_LEN)?;
    let udp = packet.get::<Udp>(ETHERNET_LEN + IPV6_LEN)?;
    // SAFETY: `get` checked the bounds.
    let (to, available) = unsafe { (*ip).datagram(&*udp, length - ETHERNET_LEN) }?;
    local::is_ours(&to).then_some(FrameLocation { at: UDP6_LEN, available, over_udp: true })
}

/// Returns the DSCP and ECN byte.
#[inline(always)]
pub fn traffic(packet: &Packet) -> u8 {
    // SAFETY: `get` checked the bounds.
    packet.get::<Ipv6>(ETHERNET_LEN).map_or(0, |ip| unsafe { (*ip).traffic() })
}

/// Writes the headers of a frame of `length` bytes.
#[inline(always)]
pub fn encapsulate(context: &XdpContext, carrier: &Carrier, hop: &NextHop, traffic: u8, length: u16) -> bool {
    let packet = Packet::of(context);
    let (Some(ethernet), Some(ip), Some(udp)) =
        (packet.get::<Ethernet>(0), packet.get::<Ipv6>(ETHERNET_LEN), packet.get::<Udp>(ETHERNET_LEN + IPV6_LEN))
    else {
        return false;
    };
    // SAFETY: `get` checked the bounds.
    unsafe {
        (*ethernet).address(&hop.destination, &hop.source, IPV6);
        (*ip).set(carrier, traffic, length);
        *udp = Udp::new(carrier, length, 0);
    }
    true
}
