//! Frames as payload of UDP over IPv4. Packets in a form that peers do not send (options,
//! fragments, inconsistent lengths) go to the host. Checksums of received packets are not verified.
//! The hop tag covers what switches forward by, and the reader's decryption names and payload.

use gdp_wire::Carrier;
use gdp_wire::packet::{self, ETHERNET_LEN, IPV4, UDP4_LEN};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

use super::checksum;
use super::ethernet::Ethernet;
use crate::carrier::packet::{FrameLocation, Ours, Payload, Stations};

pub type Udp = packet::Udp<[u8; 2]>;

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Headers {
    ethernet: Ethernet,
    ip: packet::Ipv4<[u8; 2], [u8; 4]>,
    udp: Udp,
}

#[inline]
pub fn find(packet: &[u8], ours: &impl Ours) -> Option<FrameLocation> {
    let (Headers { ip, udp, .. }, _) = Headers::ref_from_prefix(packet).ok()?;
    let (to, available) = ip.datagram(udp, packet.len() - ETHERNET_LEN)?;
    let location = FrameLocation { at: UDP4_LEN, available, over_udp: true, traffic: ip.traffic };
    ours.is_ours(&to).then_some(location)
}

#[inline]
pub fn has_checksum(carrier: &Carrier) -> bool {
    carrier.flags & Carrier::CHECKSUM != 0
}

#[inline]
pub fn encapsulate(front: &mut [u8], frame: Payload<'_>, carrier: &Carrier, stations: Stations<'_>, traffic: u8) {
    let Ok(front) = Headers::mut_from_bytes(front) else { return };
    let length = frame.length as u16;
    let checksum = match has_checksum(carrier) {
        false => 0,
        true => checksum::of_datagram(carrier, length, frame.bytes),
    };
    front.ethernet.address(stations.peer, stations.local, IPV4);
    front.ip = packet::Ipv4::new(carrier, traffic, length);
    front.udp = Udp::new(carrier, length, checksum);
}
