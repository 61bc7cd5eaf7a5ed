//! What carries a GDP frame in a packet: how it is taken off ([`find`]) and put on ([`dress`]). One file for each carrier.
//!
//! The semantics are those of the XDP programs (`gdp-ebpf/src/carrier`): exactly what they take for frames is taken here, and all
//! else is the host's. Packets are byte slices; nothing here allocates, and no input makes it panic.

mod checksum;
mod ethernet;
mod udp4;
mod udp6;

use gdp_wire::{Carrier, LocalAddress};

/// Bytes of the longest headers that [`dress`] writes.
pub const MAX_LEN: usize = udp6::LEN;

/// Where the frame lies in a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Carried {
    /// Bytes in front of it.
    pub at: usize,
    /// Bytes there are of it, and perhaps of padding behind it; perhaps none. They are all in the packet.
    pub available: usize,
    /// Whether it may also be QUIC.
    pub over_udp: bool,
    /// The byte that IP has for DSCP and ECN; 0 on Ethernet.
    pub traffic: u8,
}

/// What on an interface is taken for a carrier of frames.
pub trait Ours {
    /// Ethertype of GDP frames, in host order.
    fn ethertype(&self) -> u16;

    /// Whether the switch takes frames over UDP at the address.
    fn is_ours(&self, address: &LocalAddress) -> bool;

    /// Whether GDP runs on the VLAN with this id (0 … 4095) of the interface.
    fn is_our_vlan(&self, id: u16) -> bool;
}

/// The MAC addresses that a packet goes between, as [`Carrier`] has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stations<'a> {
    pub peer: &'a [u16; 3],
    pub local: &'a [u16; 3],
}

/// The frame in a whole packet, from its Ethernet header on; `None` if it is none of ours.
#[inline(always)]
pub fn find(packet: &[u8], ours: &impl Ours) -> Option<Carried> {
    let found = ethernet::ethertype(packet)?;
    if found == ours.ethertype() {
        return Some(ethernet::find(packet));
    }
    match found {
        ethernet::VLAN => ethernet::find_tagged(packet, ours),
        ethernet::IPV4 => udp4::find(packet, ours),
        ethernet::IPV6 => udp6::find(packet, ours),
        _ => None,
    }
}

/// Bytes in front of a frame that this carries: 14, 18, 42 or 62.
#[inline(always)]
pub fn len(carrier: &Carrier) -> usize {
    match carrier.kind {
        Carrier::UDP4 => udp4::LEN,
        Carrier::UDP6 => udp6::LEN,
        _ if carrier.vlan != 0 => ethernet::TAGGED_LEN,
        _ => ethernet::LEN,
    }
}

/// A frame that headers are put in front of.
#[derive(Clone, Copy, Debug)]
pub struct Payload<'a> {
    /// Bytes of the frame.
    pub length: usize,
    /// Those that are at hand: all of them, if the carrier [`has_checksum`].
    pub bytes: &'a [u8],
}

/// Whether the headers of this carrier have a checksum that is over the frame as well.
#[inline]
pub fn has_checksum(carrier: &Carrier) -> bool {
    match carrier.kind {
        Carrier::UDP4 => udp4::has_checksum(carrier),
        Carrier::UDP6 => udp6::has_checksum(carrier),
        _ => false,
    }
}

/// Writes the headers in front of `frame`, which goes to the peer of `carrier`. `traffic`: as [`gdp_wire::Header::ip_traffic`] says;
/// `ethertype`: of GDP frames, in host order. A `front` that has not [`len`] bytes stays as it is.
///
/// The frame must be one that the link takes: over UDP no longer than 65 507 bytes, which is what the length fields of IPv4 can tell.
#[inline]
pub fn dress(
    front: &mut [u8],
    frame: Payload<'_>,
    carrier: &Carrier,
    stations: Stations<'_>,
    traffic: u8,
    ethertype: u16,
) {
    match carrier.kind {
        Carrier::UDP4 => udp4::dress(front, frame, carrier, stations, traffic),
        Carrier::UDP6 => udp6::dress(front, frame, carrier, stations, traffic),
        _ if carrier.vlan != 0 => ethernet::dress_tagged(front, carrier.vlan, stations, traffic, ethertype),
        _ => ethernet::dress(front, stations, ethertype),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/carrier.rs"]
mod tests;
