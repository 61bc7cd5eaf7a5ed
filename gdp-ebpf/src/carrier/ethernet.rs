//! Frames as payload of Ethernet, with or without an IEEE 802.1Q tag.

use aya_ebpf::programs::XdpContext;
use gdp_wire::packet::{self, ETHERNET_LEN, TAGGED_LEN, VLAN};
use gdp_wire::{Carrier, ETHERTYPE, Vlan};

use crate::carrier::frame::FrameLocation;
use crate::packet::Packet;
use crate::{config, local};

pub type Ethernet = packet::Ethernet<u16>;
type Tag = packet::Tag<u16>;

const _: () = assert!(ETHERTYPE > 0x600);

/// Returns the ethertype in host order, or `None` if the header is incomplete.
#[inline(always)]
pub fn ethertype(packet: &Packet) -> Option<u16> {
    // SAFETY: `get` checked the bounds.
    packet.get::<Ethernet>(0).map(|header| unsafe { (*header).ethertype() })
}

#[inline(always)]
pub fn find(length: usize) -> Option<FrameLocation> {
    Some(FrameLocation { at: ETHERNET_LEN, available: length - ETHERNET_LEN, over_udp: false })
}

/// Finds a GDP frame with a VLAN tag, on a VLAN that GDP runs on. All other tagged packets,
/// including IP, belong to the host.
#[inline(always)]
pub fn find_tagged(context: &XdpContext, packet: &Packet, length: usize, ethertype: u32) -> Option<FrameLocation> {
    // SAFETY: `get` checked the bounds.
    let tag = packet.get::<Tag>(ETHERNET_LEN).map(|tag| unsafe { *tag })?;
    let vlan = Vlan { ifindex: context.ingress_ifindex() as u32, id: u32::from(tag.vlan()) };
    (u32::from(tag.ethertype()) == ethertype && local::is_our_vlan(&vlan)).then_some(FrameLocation {
        at: TAGGED_LEN,
        available: length - TAGGED_LEN,
        over_udp: false,
    })
}

#[inline(always)]
pub fn encapsulate(context: &XdpContext, carrier: &Carrier) -> bool {
    let Some(ethernet) = Packet::of(context).get::<Ethernet>(0) else { return false };
    // SAFETY: `get` checked the bounds.
    unsafe { (*ethernet).address(&carrier.peer_mac, &carrier.local_mac, config::get().ethertype as u16) };
    true
}

#[inline(always)]
pub fn encapsulate_tagged(context: &XdpContext, carrier: &Carrier, traffic: u8) -> bool {
    let packet = Packet::of(context);
    let (Some(ethernet), Some(tag)) = (packet.get::<Ethernet>(0), packet.get::<Tag>(ETHERNET_LEN)) else {
        return false;
    };
    // SAFETY: `get` checked the bounds.
    unsafe {
        (*ethernet).address(&carrier.peer_mac, &carrier.local_mac, VLAN);
        (*tag).set(carrier.vlan, traffic, config::get().ethertype as u16);
    }
    true
}
