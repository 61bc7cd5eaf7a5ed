//! Frames as payload of UDP over IPv4. What does not look as our peers send it (options, fragments,
//! lengths that disagree) is the host's to judge. Checksums of what arrives are not looked at: the
//! hop tag covers the frame's header, and the reader's decryption its payload.

use crate::carrier::udp::{HOP_LIMIT, UDP, Udp, udp_length};
use gdp_wire::{Carrier, LocalAddress};
use zerocopy::network_endian::U16;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

use super::checksum;
use super::ethernet::{self, Ethernet};
use crate::carrier::packet::{FrameLocation, Ours, Payload, Stations};

/// Bytes in front of the frame.
pub const LEN: usize = size_of::<Headers>();

/// Version 4, five words.
const VERSION_LENGTH: u8 = 0x45;
const DO_NOT_FRAGMENT: u16 = 0x4000;
/// More fragments follow, and the place of this one.
const FRAGMENT: u16 = 0x3fff;

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Ipv4 {
    version_length: u8,
    traffic: u8,
    length: U16,
    id: [u8; 2],
    fragment: U16,
    time_to_live: u8,
    protocol: u8,
    checksum: [u8; 2],
    source: [u8; 4],
    destination: [u8; 4],
}

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Headers {
    ethernet: Ethernet,
    ip: Ipv4,
    udp: Udp,
}

const _: () = assert!(LEN == 42);

#[inline]
pub fn find(packet: &[u8], ours: &impl Ours) -> Option<FrameLocation> {
    let (Headers { ip, udp, .. }, _) = Headers::ref_from_prefix(packet).ok()?;
    if ip.version_length != VERSION_LENGTH || ip.protocol != UDP || ip.fragment.get() & FRAGMENT != 0 {
        return None;
    }
    let (ip_length, udp_length) = (usize::from(ip.length.get()), usize::from(udp.length.get()));
    let available = udp_length.checked_sub(size_of::<Udp>())?;
    let fits = size_of::<Ipv4>() + udp_length <= ip_length && ethernet::LEN + ip_length <= packet.len();
    let to = LocalAddress {
        ip: [u32::from_ne_bytes(ip.destination), 0, 0, 0],
        port: u16::from_ne_bytes(udp.destination),
        kind: Carrier::UDP4.into(),
    };
    (fits && ours.is_ours(&to)).then_some(FrameLocation { at: LEN, available, over_udp: true, traffic: ip.traffic })
}

#[inline]
pub fn has_checksum(carrier: &Carrier) -> bool {
    carrier.flags & Carrier::CHECKSUM != 0
}

#[inline]
pub fn encapsulate(front: &mut [u8], frame: Payload<'_>, carrier: &Carrier, stations: Stations<'_>, traffic: u8) {
    let Ok(front) = Headers::mut_from_bytes(front) else { return };
    let (source, destination) = (carrier.local_ip[0], carrier.peer_ip[0]);
    let addresses = checksum::sum_of_words(&[source, destination]);
    let length = ((size_of::<Ipv4>() + size_of::<Udp>() + frame.length) as u16).to_be();
    // Of values, and not of the header where it is: short writes that long reads follow at once are
    // slow.
    let words = [
        u16::from_ne_bytes([VERSION_LENGTH, traffic]),
        length,
        DO_NOT_FRAGMENT.to_be(),
        u16::from_ne_bytes([HOP_LIMIT, UDP]),
    ];
    let sum = addresses + words.into_iter().map(u64::from).sum::<u64>();
    front.ethernet.address(stations, ethernet::IPV4);
    front.ip = Ipv4 {
        version_length: VERSION_LENGTH,
        traffic,
        length: U16::from_bytes(length.to_ne_bytes()),
        id: [0; 2],
        fragment: DO_NOT_FRAGMENT.into(),
        time_to_live: HOP_LIMIT,
        protocol: UDP,
        checksum: (!checksum::fold(sum)).to_ne_bytes(),
        source: source.to_ne_bytes(),
        destination: destination.to_ne_bytes(),
    };
    let udp_length = udp_length(frame);
    let udp_checksum = match has_checksum(carrier) {
        false => [0; 2],
        true => checksum::of_datagram(carrier, addresses, udp_length, frame.bytes),
    };
    front.udp = Udp::new(carrier, udp_length, udp_checksum);
}
