//! Frames as payload of UDP over IPv6, without a checksum to peers that take such datagrams (RFC
//! 6936).
//!
//! What arrives is looked at as in [`super::udp4`]; extension headers, fragments among them, are
//! the host's.

use gdp_wire::{Carrier, LocalAddress};
use zerocopy::network_endian::{U16, U32};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

use super::checksum;
use super::ethernet::{self, Ethernet};
use crate::carrier::packet::{FrameLocation, Ours, Payload, Stations};
use crate::carrier::udp::{HOP_LIMIT, UDP, Udp, udp_length};

/// Bytes in front of the frame.
pub const LEN: usize = size_of::<Headers>();

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Ipv6 {
    /// Version (4 bits), traffic class (8 bits), flow label (20 bits).
    version_class: U32,
    /// Of what follows this header.
    length: U16,
    next: u8,
    hop_limit: u8,
    source: [[u8; 4]; 4],
    destination: [[u8; 4]; 4],
}

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Headers {
    ethernet: Ethernet,
    ip: Ipv6,
    udp: Udp,
}

const _: () = assert!(LEN == 62);

#[inline]
pub fn find(packet: &[u8], ours: &impl Ours) -> Option<FrameLocation> {
    let (Headers { ip, udp, .. }, _) = Headers::ref_from_prefix(packet).ok()?;
    let version_class = ip.version_class.get();
    if version_class >> 28 != 6 || ip.next != UDP {
        return None;
    }
    let (ip_length, udp_length) = (usize::from(ip.length.get()), usize::from(udp.length.get()));
    let available = udp_length.checked_sub(size_of::<Udp>())?;
    let fits = udp_length <= ip_length && ethernet::LEN + size_of::<Ipv6>() + ip_length <= packet.len();
    let to = LocalAddress {
        ip: ip.destination.map(u32::from_ne_bytes),
        port: u16::from_ne_bytes(udp.destination),
        kind: Carrier::UDP6.into(),
    };
    let traffic = (version_class >> 20) as u8;
    (fits && ours.is_ours(&to)).then_some(FrameLocation { at: LEN, available, over_udp: true, traffic })
}

#[inline]
pub fn has_checksum(carrier: &Carrier) -> bool {
    carrier.flags & (Carrier::CHECKSUM | Carrier::ZERO_CHECKSUM) != Carrier::ZERO_CHECKSUM
}

#[inline]
pub fn encapsulate(front: &mut [u8], frame: Payload<'_>, carrier: &Carrier, stations: Stations<'_>, traffic: u8) {
    let Ok(front) = Headers::mut_from_bytes(front) else { return };
    let length = udp_length(frame);
    let checksum = match has_checksum(carrier) {
        false => [0; 2],
        true => {
            let addresses = checksum::sum_of_words(&carrier.local_ip) + checksum::sum_of_words(&carrier.peer_ip);
            checksum::of_datagram(carrier, addresses, length, frame.bytes)
        }
    };
    front.ethernet.address(stations, ethernet::IPV6);
    front.ip = Ipv6 {
        version_class: (6 << 28 | u32::from(traffic) << 20).into(),
        length,
        next: UDP,
        hop_limit: HOP_LIMIT,
        source: carrier.local_ip.map(u32::to_ne_bytes),
        destination: carrier.peer_ip.map(u32::to_ne_bytes),
    };
    front.udp = Udp::new(carrier, length, checksum);
}
