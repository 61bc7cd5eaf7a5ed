//! Frames as payload of Ethernet, with an IEEE 802.1Q tag or without.

use aya_ebpf::programs::XdpContext;
use gdp_wire::{Carrier, ETHERTYPE, Vlan};

use crate::carrier::frame::FrameLocation;
use crate::packet::Packet;
use crate::{config, local};

pub const IPV4: u16 = 0x0800;
pub const IPV6: u16 = 0x86dd;
pub const VLAN: u16 = 0x8100;

/// Bytes in front of the frame.
pub const LEN: usize = size_of::<Ethernet>();
/// With a tag.
pub const TAGGED_LEN: usize = size_of::<Ethernet>() + size_of::<Tag>();

/// As words of the alignment they have.
#[repr(C)]
pub struct Ethernet {
    pub destination: [u16; 3],
    pub source: [u16; 3],
    /// In network order, as all that follows.
    pub ethertype: u16,
}

/// What stands between a tagged frame's first ethertype and its payload.
#[repr(C)]
struct Tag {
    control: u16,
    ethertype: u16,
}

const _: () = assert!(LEN == 14 && TAGGED_LEN == 18 && ETHERTYPE > 0x600);

/// In host order; `None` if there is no whole header.
#[inline(always)]
pub fn ethertype(packet: &Packet) -> Option<u16> {
    // SAFETY: `get` checked the bounds.
    packet.get::<Ethernet>(0).map(|header| u16::from_be(unsafe { (*header).ethertype }))
}

#[inline(always)]
pub fn find(length: usize) -> Option<FrameLocation> {
    Some(FrameLocation { at: LEN, available: length - LEN, over_udp: false })
}

/// A tagged frame is ours on a VLAN that GDP runs on; others, IP among them, are the host's.
#[inline(always)]
pub fn find_tagged(context: &XdpContext, packet: &Packet, length: usize, ethertype: u32) -> Option<FrameLocation> {
    let tag = packet.get::<Tag>(LEN)?;
    // SAFETY: `get` checked the bounds.
    let (control, inner) = unsafe { (u16::from_be((*tag).control), u16::from_be((*tag).ethertype)) };
    let vlan = Vlan { ifindex: context.ingress_ifindex() as u32, id: u32::from(control & 0xfff) };
    (u32::from(inner) == ethertype && local::is_our_vlan(&vlan)).then_some(FrameLocation {
        at: TAGGED_LEN,
        available: length - TAGGED_LEN,
        over_udp: false,
    })
}

#[inline(always)]
pub fn encapsulate(context: &XdpContext, carrier: &Carrier) -> bool {
    let Some(ethernet) = Packet::of(context).get::<Ethernet>(0) else { return false };
    // SAFETY: `get` checked the bounds.
    unsafe { address(ethernet, carrier.peer_mac, carrier.local_mac, config::get().ethertype as u16) };
    true
}

#[inline(always)]
pub fn encapsulate_tagged(context: &XdpContext, carrier: &Carrier, traffic: u8) -> bool {
    let packet = Packet::of(context);
    let (Some(ethernet), Some(tag)) = (packet.get::<Ethernet>(0), packet.get::<Tag>(LEN)) else { return false };
    // SAFETY: `get` checked the bounds.
    unsafe {
        address(ethernet, carrier.peer_mac, carrier.local_mac, VLAN);
        (*tag).control = (carrier.vlan & 0xfff | u16::from(traffic >> 5) << 13).to_be();
        (*tag).ethertype = (config::get().ethertype as u16).to_be();
    }
    true
}

/// Writes an Ethernet header. `ethertype`: in host order.
///
/// # Safety
///
/// `ethernet` must be writable.
#[inline(always)]
pub unsafe fn address(ethernet: *mut Ethernet, destination: [u16; 3], source: [u16; 3], ethertype: u16) {
    let mut i = 0;
    while i < 3 {
        // SAFETY: the caller's promise. Word by word, because a copy of six bytes becomes a
        // function call.
        unsafe {
            (*ethernet).destination[i] = destination[i];
            (*ethernet).source[i] = source[i];
        }
        i += 1;
    }
    // SAFETY: the caller's promise.
    unsafe { (*ethernet).ethertype = ethertype.to_be() };
}
