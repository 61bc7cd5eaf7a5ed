//! Frames as payload of Ethernet, with or without an IEEE 802.1Q tag.

use gdp_wire::packet::{self, ETHERNET_LEN, TAGGED_LEN, VLAN};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

use crate::carrier::packet::{FrameLocation, Ours, Stations};

pub type Ethernet = packet::Ethernet<[u8; 2]>;

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Tagged {
    ethernet: Ethernet,
    tag: packet::Tag<[u8; 2]>,
}

/// Returns the ethertype in host order; `None` if the header is incomplete.
#[inline(always)]
pub fn ethertype(packet: &[u8]) -> Option<u16> {
    Ethernet::ref_from_prefix(packet).ok().map(|(header, _)| header.ethertype())
}

/// Returns the frame in a packet with a complete header.
#[inline(always)]
pub fn find(packet: &[u8]) -> FrameLocation {
    let available = packet.len().saturating_sub(ETHERNET_LEN);
    FrameLocation { at: ETHERNET_LEN, available, over_udp: false, traffic: 0 }
}

/// Returns the frame in a tagged packet on a VLAN on which GDP runs. Other tagged packets,
/// including IP, go to the host.
#[inline]
pub fn find_tagged(packet: &[u8], ours: &impl Ours) -> Option<FrameLocation> {
    let (Tagged { tag, .. }, rest) = Tagged::ref_from_prefix(packet).ok()?;
    let is_ours = tag.ethertype() == ours.ethertype() && ours.is_our_vlan(tag.vlan());
    is_ours.then_some(FrameLocation { at: TAGGED_LEN, available: rest.len(), over_udp: false, traffic: 0 })
}

#[inline]
pub fn encapsulate(front: &mut [u8], stations: Stations<'_>, ethertype: u16) {
    if let Ok(front) = Ethernet::mut_from_bytes(front) {
        front.address(stations.peer, stations.local, ethertype);
    }
}

/// Writes a tagged header. Its priority is the traffic class: the high three bits of `traffic`.
#[inline]
pub fn encapsulate_tagged(front: &mut [u8], vlan: u16, stations: Stations<'_>, traffic: u8, ethertype: u16) {
    if let Ok(front) = Tagged::mut_from_bytes(front) {
        front.ethernet.address(stations.peer, stations.local, VLAN);
        front.tag.set(vlan, traffic, ethertype);
    }
}
