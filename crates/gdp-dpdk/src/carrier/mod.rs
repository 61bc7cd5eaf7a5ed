//! What carries a GDP frame in a packet: how it is taken off ([`find`]) and put on
//! ([`encapsulate`]). One file for each carrier.
//!
//! The semantics are those of the XDP programs (`gdp-ebpf/src/carrier`): exactly what they take for
//! frames is taken here, and all else is the host's. Packets are byte slices; nothing here
//! allocates, and no input makes it panic.

mod checksum;
mod ethernet;
mod packet;
mod udp4;
mod udp6;

pub use crate::carrier::packet::{FrameLocation, Ours, Payload, Stations};
use gdp_wire::Carrier;
use gdp_wire::packet::{ETHERNET_LEN, IPV4, IPV6, TAGGED_LEN, UDP4_LEN, UDP6_LEN, VLAN};

/// Bytes of the longest headers that [`encapsulate`] writes.
pub const MAX_LEN: usize = UDP6_LEN;

/// The frame in a whole packet, from its Ethernet header on; `None` if it is none of ours.
#[inline(always)]
pub fn find(packet: &[u8], ours: &impl Ours) -> Option<FrameLocation> {
    let found = ethernet::ethertype(packet)?;
    if found == ours.ethertype() {
        return Some(ethernet::find(packet));
    }
    match found {
        VLAN => ethernet::find_tagged(packet, ours),
        IPV4 => udp4::find(packet, ours),
        IPV6 => udp6::find(packet, ours),
        _ => None,
    }
}

/// Bytes in front of a frame that this carries: 14, 18, 42 or 62.
#[inline(always)]
pub fn len(carrier: &Carrier) -> usize {
    match carrier.kind {
        Carrier::UDP4 => UDP4_LEN,
        Carrier::UDP6 => UDP6_LEN,
        _ if carrier.vlan != 0 => TAGGED_LEN,
        _ => ETHERNET_LEN,
    }
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

/// Writes the headers in front of `frame`, which goes to the peer of `carrier`. `traffic`: as
/// [`gdp_wire::Header::ip_traffic`] says; `ethertype`: of GDP frames, in host order. A `front` that
/// has not [`len`] bytes stays as it is.
///
/// The frame must be one that the link takes: over UDP no longer than 65 507 bytes, which is what
/// the length fields of IPv4 can tell.
#[inline]
pub fn encapsulate(
    front: &mut [u8],
    frame: Payload<'_>,
    carrier: &Carrier,
    stations: Stations<'_>,
    traffic: u8,
    ethertype: u16,
) {
    match carrier.kind {
        Carrier::UDP4 => udp4::encapsulate(front, frame, carrier, stations, traffic),
        Carrier::UDP6 => udp6::encapsulate(front, frame, carrier, stations, traffic),
        _ if carrier.vlan != 0 => ethernet::encapsulate_tagged(front, carrier.vlan, stations, traffic, ethertype),
        _ => ethernet::encapsulate(front, stations, ethertype),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/carrier.rs"]
mod tests;
