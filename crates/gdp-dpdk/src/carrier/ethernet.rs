//! Frames as payload of Ethernet, with an IEEE 802.1Q tag or without.

use zerocopy::network_endian::U16;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned, transmute};

use crate::carrier::packet::{FrameLocation, Ours, Stations};

pub const IPV4: u16 = 0x0800;
pub const IPV6: u16 = 0x86dd;
pub const VLAN: u16 = 0x8100;

/// Bytes in front of the frame.
pub const LEN: usize = size_of::<Ethernet>();
/// With a tag.
pub const TAGGED_LEN: usize = size_of::<Tagged>();

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
pub struct Ethernet {
    destination: [u8; 6],
    source: [u8; 6],
    ethertype: U16,
}

#[derive(FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Tagged {
    /// Its ethertype is [`VLAN`].
    ethernet: Ethernet,
    /// Priority (3 bits), drop eligibility (1 bit), VLAN id (12 bits).
    control: U16,
    ethertype: U16,
}

const _: () = assert!(LEN == 14 && TAGGED_LEN == 18);

impl Ethernet {
    /// Makes it one from us to the peer. `ethertype`: in host order.
    #[inline]
    pub fn address(&mut self, stations: Stations<'_>, ethertype: u16) {
        // In place: a header made elsewhere is copied with reads that span the writes before them,
        // which is slow.
        self.destination = transmute!(*stations.peer);
        self.source = transmute!(*stations.local);
        self.ethertype = ethertype.into();
    }
}

/// In host order; `None` if there is no whole header.
#[inline(always)]
pub fn ethertype(packet: &[u8]) -> Option<u16> {
    Ethernet::ref_from_prefix(packet).ok().map(|(header, _)| header.ethertype.get())
}

/// In a packet that has a whole header.
#[inline(always)]
pub fn find(packet: &[u8]) -> FrameLocation {
    FrameLocation { at: LEN, available: packet.len().saturating_sub(LEN), over_udp: false, traffic: 0 }
}

/// A tagged frame is ours on a VLAN that GDP runs on; others, IP among them, are the host's.
#[inline]
pub fn find_tagged(packet: &[u8], ours: &impl Ours) -> Option<FrameLocation> {
    let (header, rest) = Tagged::ref_from_prefix(packet).ok()?;
    let is_ours = header.ethertype.get() == ours.ethertype() && ours.is_our_vlan(header.control.get() & 0xfff);
    is_ours.then_some(FrameLocation { at: TAGGED_LEN, available: rest.len(), over_udp: false, traffic: 0 })
}

#[inline]
pub fn encapsulate(front: &mut [u8], stations: Stations<'_>, ethertype: u16) {
    if let Ok(front) = Ethernet::mut_from_bytes(front) {
        front.address(stations, ethertype);
    }
}

/// The priority is the traffic class: the high three bits of `traffic`.
#[inline]
pub fn encapsulate_tagged(front: &mut [u8], vlan: u16, stations: Stations<'_>, traffic: u8, ethertype: u16) {
    if let Ok(front) = Tagged::mut_from_bytes(front) {
        front.ethernet.address(stations, VLAN);
        front.control = (vlan & 0xfff | u16::from(traffic >> 5) << 13).into();
        front.ethertype = ethertype.into();
    }
}
