//! Frames as payload of UDP over IPv4. What does not look as our peers send it (options, fragments,
//! lengths that disagree) is the host's to judge. Checksums of what arrives are not looked at: the
//! hop tag covers the frame's header, and the reader's decryption its payload.

use aya_ebpf::programs::XdpContext;
use gdp_wire::Carrier;
use gdp_wire::packet::{self, ETHERNET_LEN, IPV4, IPV4_LEN, UDP4_LEN};

use crate::carrier::ethernet::Ethernet;
use crate::carrier::frame::FrameLocation;
use crate::local;
use crate::next_hop::NextHop;
use crate::packet::Packet;

type Ipv4 = packet::Ipv4<u16, u32>;
pub type Udp = packet::Udp<u16>;

#[inline(always)]
pub fn find(packet: &Packet, length: usize) -> Option<FrameLocation> {
    let ip = packet.get::<Ipv4>(ETHERNET_LEN)?;
    let udp = packet.get::<Udp>(ETHERNET_LEN + IPV4_LEN)?;
    // SAFETY: `get` checked the bounds.
    let (to, available) = unsafe { (*ip).datagram(&*udp, length - ETHERNET_LEN) }?;
    local::is_ours(&to).then_some(FrameLocation { at: UDP4_LEN, available, over_udp: true })
}

/// The byte for DSCP and ECN.
#[inline(always)]
pub fn traffic(packet: &Packet) -> u8 {
    // SAFETY: `get` checked the bounds.
    packet.get::<Ipv4>(ETHERNET_LEN).map_or(0, |ip| unsafe { (*ip).traffic })
}

/// What is in front of a frame, if there is room for it.
#[inline(always)]
fn headers(packet: &Packet) -> Option<(*mut Ethernet, *mut Ipv4, *mut Udp)> {
    Some((packet.get(0)?, packet.get(ETHERNET_LEN)?, packet.get(ETHERNET_LEN + IPV4_LEN)?))
}

/// Sends a datagram back to where it came from: only that its sender's address is on this host
/// makes sense of it there. `false` if it is none.
#[inline(always)]
pub fn turn_back(packet: &Packet) -> bool {
    let Some((ethernet, ip, udp)) = headers(packet) else { return false };
    // SAFETY: `get` checked the bounds.
    unsafe {
        if (*ethernet).ethertype() != IPV4 {
            return false;
        }
        let (to, from) = ((*ethernet).source, (*ethernet).destination);
        (*ethernet).address(&to, &from, IPV4);
        // Their sum stays what it was.
        let (to, from) = ((*ip).source, (*ip).destination);
        (*ip).source = from;
        (*ip).destination = to;
        // The sender left it to be finished by hardware that is not there.
        (*udp).checksum = 0;
    }
    true
}

/// `length`: of the frame. `routed`: whether `hop` says which stations it goes between, and not the
/// carrier.
#[inline(always)]
pub fn encapsulate(
    context: &XdpContext,
    carrier: &Carrier,
    routed: bool,
    hop: &NextHop,
    traffic: u8,
    length: u16,
) -> bool {
    let packet = Packet::of(context);
    let Some((ethernet, ip, udp)) = headers(&packet) else { return false };
    // SAFETY: `get` checked the bounds.
    unsafe {
        if routed {
            (*ethernet).address(&hop.destination, &hop.source, IPV4);
        } else {
            (*ethernet).address(&carrier.peer_mac, &carrier.local_mac, IPV4);
        }
        *ip = Ipv4::new(carrier, traffic, length);
        *udp = Udp::new(carrier, length, 0);
    }
    true
}
