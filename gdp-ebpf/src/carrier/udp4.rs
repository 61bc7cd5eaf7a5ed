//! Frames as payload of UDP over IPv4. Packets that peers do not send in this form (options,
//! fragments, inconsistent lengths) go to the host. Checksums of received packets are not verified:
//! the hop tag covers the frame's header, and the reader's decryption its payload.

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

/// Returns the DSCP and ECN byte.
#[inline(always)]
pub fn traffic(packet: &Packet) -> u8 {
    // SAFETY: `get` checked the bounds.
    packet.get::<Ipv4>(ETHERNET_LEN).map_or(0, |ip| unsafe { (*ip).traffic })
}

/// Returns the headers in front of a frame, if there is room for them.
#[inline(always)]
fn headers(packet: &Packet) -> Option<(*mut Ethernet, *mut Ipv4, *mut Udp)> {
    Some((packet.get(0)?, packet.get(ETHERNET_LEN)?, packet.get(ETHERNET_LEN + IPV4_LEN)?))
}

/// Swaps the source and destination of a datagram, to send it back to its sender. The datagram is
/// meaningful to the sender because the sender's address is on this host. Returns `false` if the
/// packet is not IPv4.
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
        // The header checksum does not change.
        let (to, from) = ((*ip).source, (*ip).destination);
        (*ip).source = from;
        (*ip).destination = to;
        // The sender left the checksum to be completed by hardware, which is absent here.
        (*udp).checksum = 0;
    }
    true
}

/// Writes the headers of a frame of `length` bytes. `routed` selects the MAC addresses of `hop`
/// instead of those of the carrier.
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
