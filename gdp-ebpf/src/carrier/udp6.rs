//! Frames as payload of UDP over IPv6, to peers that take datagrams without a checksum (RFC 6936).
//! Those that do not are sent to by the userspace plane: not every frame can be summed up here, see
//! [`super::checksum`].
//!
//! What arrives is looked at as in [`super::udp4`]; extension headers, fragments among them, are
//! the host's.

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

/// The byte for DSCP and ECN.
#[inline(always)]
pub fn traffic(packet: &Packet) -> u8 {
    // SAFETY: `get` checked the bounds.
    packet.get::<Ipv6>(ETHERNET_LEN).map_or(0, |ip| unsafe { (*ip).traffic() })
}

/// `length`: of the frame.
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
