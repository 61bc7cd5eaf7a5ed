//! Frames as payload of UDP over IPv6, to peers that take datagrams without a checksum (RFC 6936).
//! Those that do not are sent to by the userspace plane: not every frame can be summed up here, see
//! [`super::checksum`].
//!
//! What arrives is looked at as in [`super::udp4`]; extension headers, fragments among them, are
//! the host's.

use aya_ebpf::programs::XdpContext;
use gdp_wire::{Carrier, LocalAddress};

use super::ethernet::{self, Ethernet};
use crate::carrier::frame::FrameLocation;
use crate::carrier::udp::{HOP_LIMIT, UDP, Udp};
use crate::local;
use crate::next_hop::NextHop;
use crate::packet::Packet;

/// Bytes in front of the frame.
pub const LEN: usize = ethernet::LEN + size_of::<Ipv6>() + size_of::<Udp>();

/// In network order.
#[repr(C)]
struct Ipv6 {
    /// Version, traffic class, flow label.
    version_class: u32,
    /// Of what follows this header.
    length: u16,
    next: u8,
    hop_limit: u8,
    source: [u32; 4],
    destination: [u32; 4],
}

const _: () = assert!(LEN == 62);

#[inline(always)]
pub fn find(packet: &Packet, length: usize) -> Option<FrameLocation> {
    let ip = packet.get::<Ipv6>(ethernet::LEN)?;
    let udp = packet.get::<Udp>(ethernet::LEN + size_of::<Ipv6>())?;
    // SAFETY: `get` checked the bounds.
    let (ip, udp) = unsafe { (&*ip, &*udp) };
    if u32::from_be(ip.version_class) >> 28 != 6 || ip.next != UDP {
        return None;
    }
    let to = LocalAddress { ip: ip.destination, port: udp.destination, kind: Carrier::UDP6.into() };
    let (ip_length, udp_length) = (u16::from_be(ip.length) as usize, u16::from_be(udp.length) as usize);
    let fits = udp_length >= size_of::<Udp>()
        && udp_length <= ip_length
        && ethernet::LEN + size_of::<Ipv6>() + ip_length <= length;
    (fits && local::is_ours(&to)).then_some(FrameLocation {
        at: LEN,
        available: udp_length - size_of::<Udp>(),
        over_udp: true,
    })
}

/// The byte for DSCP and ECN.
#[inline(always)]
pub fn traffic(packet: &Packet) -> u8 {
    // SAFETY: `get` checked the bounds.
    packet.get::<Ipv6>(ethernet::LEN).map_or(0, |ip| unsafe { (u32::from_be((*ip).version_class) >> 20) as u8 })
}

/// `length`: of the frame.
#[inline(always)]
pub fn encapsulate(context: &XdpContext, carrier: &Carrier, hop: &NextHop, traffic: u8, length: u16) -> bool {
    let packet = Packet::of(context);
    let (Some(ethernet), Some(ip), Some(udp)) = (
        packet.get::<Ethernet>(0),
        packet.get::<Ipv6>(ethernet::LEN),
        packet.get::<Udp>(ethernet::LEN + size_of::<Ipv6>()),
    ) else {
        return false;
    };
    let length = (length + size_of::<Udp>() as u16).to_be();
    // SAFETY: `get` checked the bounds.
    unsafe {
        ethernet::address(ethernet, hop.destination, hop.source, ethernet::IPV6);
        (*ip).version_class = (6 << 28 | u32::from(traffic) << 20).to_be();
        (*ip).length = length;
        (*ip).next = UDP;
        (*ip).hop_limit = HOP_LIMIT;
        let mut i = 0;
        while i < 4 {
            (*ip).source[i] = carrier.local_ip[i];
            (*ip).destination[i] = carrier.peer_ip[i];
            i += 1;
        }
        *udp = Udp { source: carrier.local_port, destination: carrier.peer_port, length, checksum: 0 };
    }
    true
}
