//! Frames as payload of UDP over IPv4. What does not look as our peers send it (options, fragments,
//! lengths that disagree) is the host's to judge. Checksums of what arrives are not looked at: the
//! hop tag covers the frame's header, and the reader's decryption its payload.

use crate::carrier::udp::{HOP_LIMIT, UDP, Udp};
use aya_ebpf::programs::XdpContext;
use gdp_wire::{Carrier, LocalAddress};

use super::ethernet::{self, Ethernet};
use crate::carrier::frame::FrameLocation;
use crate::local;
use crate::next_hop::NextHop;
use crate::packet::Packet;

const HEADERS: usize = size_of::<Ipv4>() + size_of::<Udp>();

/// Bytes in front of the frame.
pub const LEN: usize = ethernet::LEN + HEADERS;

/// Version 4, five words.
const VERSION_LENGTH: u8 = 0x45;
const DO_NOT_FRAGMENT: u16 = 0x4000;
/// More fragments follow, and the place of this one.
const FRAGMENT: u16 = 0x3fff;

/// In network order.
#[repr(C)]
struct Ipv4 {
    version_length: u8,
    traffic: u8,
    length: u16,
    id: u16,
    fragment: u16,
    time_to_live: u8,
    protocol: u8,
    checksum: u16,
    source: u32,
    destination: u32,
}

const _: () = assert!(LEN == 42);

#[inline(always)]
pub fn find(packet: &Packet, length: usize) -> Option<FrameLocation> {
    let ip = packet.get::<Ipv4>(ethernet::LEN)?;
    let udp = packet.get::<Udp>(ethernet::LEN + size_of::<Ipv4>())?;
    // SAFETY: `get` checked the bounds.
    let (ip, udp) = unsafe { (&*ip, &*udp) };
    if ip.version_length != VERSION_LENGTH || ip.protocol != UDP || u16::from_be(ip.fragment) & FRAGMENT != 0 {
        return None;
    }
    let to = LocalAddress { ip: [ip.destination, 0, 0, 0], port: udp.destination, kind: Carrier::UDP4.into() };
    let (ip_length, udp_length) = (u16::from_be(ip.length) as usize, u16::from_be(udp.length) as usize);
    let fits = udp_length >= size_of::<Udp>()
        && size_of::<Ipv4>() + udp_length <= ip_length
        && ethernet::LEN + ip_length <= length;
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
    packet.get::<Ipv4>(ethernet::LEN).map_or(0, |ip| unsafe { (*ip).traffic })
}

/// What is in front of a frame, if there is room for it.
#[inline(always)]
fn headers(packet: &Packet) -> Option<(*mut Ethernet, *mut Ipv4, *mut Udp)> {
    let behind = ethernet::LEN + size_of::<Ipv4>();
    Some((packet.get(0)?, packet.get(ethernet::LEN)?, packet.get(behind)?))
}

/// Sends a datagram back to where it came from: only that its sender's address is on this host
/// makes sense of it there. `false` if it is none.
#[inline(always)]
pub fn turn_back(packet: &Packet) -> bool {
    let Some((ethernet, ip, udp)) = headers(packet) else { return false };
    // SAFETY: `get` checked the bounds.
    unsafe {
        if (*ethernet).ethertype != ethernet::IPV4.to_be() {
            return false;
        }
        let (to, from) = ((*ethernet).source, (*ethernet).destination);
        ethernet::address(ethernet, to, from, ethernet::IPV4);
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
    let (ip_length, fragment) = ((length + HEADERS as u16).to_be(), DO_NOT_FRAGMENT.to_be());
    let (source, destination) = (carrier.local_ip[0], carrier.peer_ip[0]);
    let words = [
        u16::from_ne_bytes([VERSION_LENGTH, traffic]) as u32,
        ip_length as u32,
        fragment as u32,
        u16::from_ne_bytes([HOP_LIMIT, UDP]) as u32,
        source & 0xffff,
        source >> 16,
        destination & 0xffff,
        destination >> 16,
    ];
    // RFC 1071: the order of bytes does not matter as long as it is one.
    let sum = words[0] + words[1] + words[2] + words[3] + words[4] + words[5] + words[6] + words[7];
    let sum = (sum & 0xffff) + (sum >> 16);
    let sum = (sum & 0xffff) + (sum >> 16);
    // SAFETY: `get` checked the bounds.
    unsafe {
        if routed {
            ethernet::address(ethernet, hop.destination, hop.source, ethernet::IPV4);
        } else {
            ethernet::address(ethernet, carrier.peer_mac, carrier.local_mac, ethernet::IPV4);
        }
        *ip = Ipv4 {
            version_length: VERSION_LENGTH,
            traffic,
            length: ip_length,
            id: 0,
            fragment,
            time_to_live: HOP_LIMIT,
            protocol: UDP,
            checksum: !(sum as u16),
            source,
            destination,
        };
        *udp = Udp {
            source: carrier.local_port,
            destination: carrier.peer_port,
            length: (length + size_of::<Udp>() as u16).to_be(),
            checksum: 0,
        };
    }
    true
}
