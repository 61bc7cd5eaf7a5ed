//! The carrier of a GDP frame, and its replacement by the carrier of the next link. The frame
//! itself stays at its position in memory: the start of the packet moves, and headers are written
//! in front of the frame.
//!
//! One file per carrier, with its decapsulation (`find`) and encapsulation (`encapsulate`). Called
//! by `main.rs`.

mod checksum;
pub mod ethernet;
mod frame;
pub mod udp4;
pub mod udp6;

pub use crate::carrier::frame::FrameLocation;
use aya_ebpf::programs::XdpContext;
use gdp_wire::header::FIRST_QUIC_BYTE;
use gdp_wire::packet::{ETHERNET_LEN, IPV4, IPV6, TAGGED_LEN, UDP_LEN, UDP4_LEN, UDP6_LEN, VLAN};
use gdp_wire::table::PORT_ROUTED;
use gdp_wire::{Carrier, LinkEntry};

use crate::next_hop::NextHop;
use crate::packet::{self, Packet};
use crate::verifier;

/// Returns the frame in a packet of `length` bytes, or `None` if it carries none for this switch.
/// `ethertype` is that of GDP frames, in host order. The paths of all carriers join here.
#[inline(always)]
pub fn locate(context: &XdpContext, packet: &Packet, length: usize, ethertype: u32) -> Option<FrameLocation> {
    /// Mask that bounds an offset for the verifier.
    const OFFSETS: usize = 0x3f;
    const { assert!(UDP6_LEN <= OFFSETS) };
    let FrameLocation { at, available, over_udp } = find(context, packet, length, ethertype)?;
    // SAFETY: `get` checked the bounds.
    let unknown = unsafe { *packet.get::<u64>(0)? };
    Some(FrameLocation {
        at: verifier::join(at, unknown) & OFFSETS,
        available: verifier::join(available, unknown),
        over_udp: verifier::join(over_udp, unknown),
    })
}

/// Returns the same as [`locate`], with an offset that depends on the path.
#[inline(always)]
fn find(context: &XdpContext, packet: &Packet, length: usize, ethertype: u32) -> Option<FrameLocation> {
    let found = ethernet::ethertype(packet)?;
    if u32::from(found) == ethertype {
        return ethernet::find(length);
    }
    match found {
        VLAN => ethernet::find_tagged(context, packet, length, ethertype),
        IPV4 => udp4::find(packet, length),
        IPV6 => udp6::find(packet, length),
        _ => None,
    }
}

/// Returns whether the payload is QUIC, by its first byte.
#[inline(always)]
pub fn is_quic(carried: &FrameLocation, first_byte: u8) -> bool {
    carried.over_udp && first_byte >= FIRST_QUIC_BYTE
}

/// Returns the DSCP and ECN byte of the IP header that carries a frame; 0 on Ethernet. Read again
/// here: if [`find`] returned the byte, the compiler would spill it also where it is uninitialised,
/// which the verifier rejects.
#[inline(always)]
pub fn traffic(packet: &Packet, carried: &FrameLocation) -> u8 {
    match carried.at {
        UDP4_LEN => udp4::traffic(packet),
        UDP6_LEN => udp6::traffic(packet),
        _ => 0,
    }
}

/// Replaces the headers before the frame at offset `at` with those of `link`, and keeps `length`
/// bytes of the frame. Returns `false` if there is no room. Invalidates references into the packet.
/// `behind` is the number of bytes after the frame, `traffic` the byte of
/// `gdp_wire::Header::ip_traffic`.
#[inline(always)]
pub fn exchange(
    context: &XdpContext,
    at: usize,
    length: usize,
    behind: usize,
    traffic: u8,
    link: &LinkEntry,
    hop: &NextHop,
) -> bool {
    let carrier = &link.carrier;
    if !packet::cut(context, behind) {
        return false;
    }
    let udp = match carrier.kind {
        Carrier::UDP4 => UDP4_LEN - UDP_LEN,
        Carrier::UDP6 => UDP6_LEN - UDP_LEN,
        _ => 0,
    };
    let done = match carrier.kind {
        Carrier::UDP4 => {
            packet::shift(context, at, UDP4_LEN)
                && udp4::encapsulate(context, carrier, link.port == PORT_ROUTED, hop, traffic, length as u16)
        }
        Carrier::UDP6 => {
            packet::shift(context, at, UDP6_LEN) && udp6::encapsulate(context, carrier, hop, traffic, length as u16)
        }
        _ if carrier.vlan != 0 => {
            packet::shift(context, at, TAGGED_LEN) && ethernet::encapsulate_tagged(context, carrier, traffic)
        }
        _ => packet::shift(context, at, ETHERNET_LEN) && ethernet::encapsulate(context, carrier),
    };
    if done && udp > 0 && carrier.flags & Carrier::CHECKSUM != 0 {
        checksum::write(context, carrier, udp, length + UDP_LEN);
    }
    done
}
