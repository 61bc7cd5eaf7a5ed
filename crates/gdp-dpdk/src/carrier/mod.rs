//! Encapsulation of GDP frames in packets: [`find`] removes it and [`encapsulate`] adds it. Each
//! carrier has its own file.
//!
//! The semantics are those of the XDP programs (`gdp-ebpf/src/carrier`): both accept exactly the
//! same packets as frames, and all others go to the host. Packets are byte slices. This module does
//! not allocate, and no input makes it panic.

mod checksum;
mod ethernet;
mod packet;
mod udp4;
mod udp6;

pub use crate::carrier::packet::{FrameLocation, Ours, Payload, Stations};
use gdp_wire::Carrier;
use gdp_wire::packet::{ETHERNET_LEN, IPV4, IPV6, TAGGED_LEN, UDP4_LEN, UDP6_LEN, VLAN};

/// Length in bytes of the longest headers that [`encapsulate`] writes.
pub const MAX_LEN: usize = UDP6_LEN;

/// Returns the frame in a whole packet with its Ethernet header; `None` if the packet has no frame
/// to this switch.
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

/// Returns the length in bytes of this carrier's headers: 14, 18, 42 or 62.
#[inline(always)]
pub fn len(carrier: &Carrier) -> usize {
    match carrier.kind {
        Carrier::UDP4 => UDP4_LEN,
        Carrier::UDP6 => UDP6_LEN,
        _ if carrier.vlan != 0 => TAGGED_LEN,
        _ => ETHERNET_LEN,
    }
}

/// Returns whether the headers of this carrier have a checksum that also covers the frame.
#[inline]
pub fn has_checksum(carrier: &Carrier) -> bool {
    match carrier.kind {
        Carrier::UDP4 => udp4::has_checksum(carrier),
        Carrier::UDP6 => udp6::has_checksum(carrier),
        _ => false,
    }
}

/// Writes the headers in front of `frame`, which goes to the peer of `carrier`. `traffic`: the
/// value of [`gdp_wire::Header::ip_traffic`]. `ethertype`: ethertype of GDP frames, in host order.
/// A `front` whose length is not [`len`] bytes stays unchanged.
///
/// The frame must fit the link: over UDP at most 65 507 bytes, the limit of the IPv4 length fields.
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
