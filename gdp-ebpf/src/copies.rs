//! Labels that tell the egress program which link a copy is for. The switch writes the label over
//! the Ethernet addresses, which are no longer needed. The label therefore survives in the copies
//! of every driver, unlike XDP metadata. All copies of a frame are otherwise identical:
//! [`gdp_wire::forward::copy`] makes the frame for each link.
//!
//! The kernel makes the copies of a frame that leave by one interface in sequence, on the CPU of
//! the switch program. The index of a copy is therefore a count per CPU and interface, in
//! `COUNTED`. User space creates the entry of an interface before the interface takes frames. Only
//! the programs on the CPU write its value. `SEQUENCE` distinguishes frames.
//!
//! The egress program drops a copy that no link needs, except the last copy at its interface. The
//! kernel sends up to 16 frames in a batch. If the program drops all frames of the last batch, the
//! kernel does not flush the driver. Earlier frames would then wait for the next frame. The last
//! copy therefore always leaves, as a filler if no link needs it.

use aya_ebpf::macros::map;
use aya_ebpf::maps::{PerCpuArray, PerCpuHashMap};
use aya_ebpf::programs::XdpContext;
use gdp_wire::packet::ETHERNET_LEN;
use gdp_wire::table::{CopyCount, MAX_PORTS};
use gdp_wire::{GroupSlot, Header};

use crate::carrier::ethernet::Ethernet;
use crate::packet::{self, Packet};

#[map]
static SEQUENCE: PerCpuArray<u64> = PerCpuArray::with_max_entries(1, 0);

#[map]
static COUNTED: PerCpuHashMap<u32, CopyCount> = PerCpuHashMap::with_max_entries(MAX_PORTS, 0);

/// Marks a label. No interface has a group address as its own, so the source address of no other
/// frame starts with this value.
const MARK: u16 = 0xffff;

/// The label of a copy, written over the Ethernet addresses.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Label {
    /// The low 48 bits of the sequence number of the frame on this CPU.
    sequence: [u16; 3],
    mark: u16,
    group: u16,
    zero: u16,
}

const _: () = assert!(size_of::<Label>() <= ETHERNET_LEN);

/// Labels a frame before the kernel copies it. Returns `false` if the frame cannot be labelled.
#[inline(always)]
pub fn label(packet: &Packet, group: u32) -> bool {
    let (Some(sequence), Some(at)) = (SEQUENCE.get_ptr_mut(0), packet.get::<Label>(0)) else { return false };
    // SAFETY: this CPU's slot, which nobody else writes; `get` checked the bounds.
    unsafe {
        *sequence += 1;
        let words = [*sequence as u16, (*sequence >> 16) as u16, (*sequence >> 32) as u16];
        *at = Label { sequence: words, mark: MARK, group: group as u16, zero: 0 };
    }
    true
}

impl Label {
    /// Returns the label of a packet, or `None` if the packet is not a copy.
    #[inline(always)]
    pub fn of(packet: &Packet) -> Option<Self> {
        // SAFETY: `get` checked the bounds, and any bytes are a label.
        packet.get::<Self>(0).map(|label| unsafe { *label }).filter(|label| label.mark == MARK)
    }

    /// Returns the group slot of this copy, which now leaves by `interface`. Must be called once
    /// per copy.
    #[inline(always)]
    pub fn slot(&self, interface: u32) -> Option<GroupSlot> {
        let [low, middle, high] = self.sequence.map(u64::from);
        let sequence = low | middle << 16 | high << 32;
        // SAFETY: this CPU's value of an element that exists while its interface takes frames. No
        // other CPU writes the value.
        let counted = unsafe { &mut *COUNTED.get_ptr_mut(interface)? };
        let index = if counted.sequence == sequence { counted.copies } else { 0 };
        *counted = CopyCount { sequence, copies: index + 1, ..*counted };
        Some(GroupSlot { group: self.group.into(), interface, index })
    }
}

/// Counts a copy that is dropped because no link needs it.
#[inline(always)]
pub fn count_superfluous(interface: u32) {
    if let Some(counted) = COUNTED.get_ptr_mut(interface) {
        // SAFETY: this CPU's value of an element, as above.
        unsafe { (*counted).superfluous += 1 };
    }
}

/// Returns the number of superfluous copies since the last call, and resets it.
#[inline(always)]
pub fn take_superfluous(interface: u32) -> u64 {
    let Some(counted) = COUNTED.get_ptr_mut(interface) else { return 0 };
    // SAFETY: this CPU's value of an element, as above.
    unsafe { core::mem::take(&mut (*counted).superfluous).into() }
}

/// Replaces a copy with a frame of minimum length that contains nothing of the copy. Bridges do not
/// forward the frame (IEEE 802.1Q, reserved group address). Hosts do not accept it (IEEE 802, local
/// experimental ethertype 2).
#[inline(always)]
pub fn make_discardable(context: &XdpContext) -> bool {
    const SHORTEST: usize = 60;
    const DESTINATION: [u16; 3] = [0x0180u16.to_be(), 0xc200u16.to_be(), 0x000eu16.to_be()];
    const SOURCE: [u16; 3] = [0x0200u16.to_be(), 0, 0];
    let mut packet = Packet::of(context);
    let Some(ethernet) = packet.get::<Ethernet>(0) else { return false };
    // SAFETY: `get` checked the bounds.
    unsafe { (*ethernet).address(&DESTINATION, &SOURCE, 0x88b6) };
    let Some(header) = packet.header(ETHERNET_LEN) else { return false };
    *header = Header::default();
    packet::cut(context, (context.data_end() - context.data()).saturating_sub(SHORTEST))
}
