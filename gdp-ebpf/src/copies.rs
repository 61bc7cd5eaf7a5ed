//! From the switch to the program at the interface where a copy leaves: what the copy is for. It is
//! written in place of the Ethernet addresses, which no longer matter then; so it reaches every
//! driver's copies, whereas XDP metadata would not. The rest of the frame is the same for all
//! copies: [`gdp_wire::forward::copy`] makes each of them from it.
//!
//! The kernel makes the copies of a frame that leave by one interface in a row, on the CPU that the
//! switch ran on. So a count by CPU and interface tells them apart: `COUNTED`, of which user space
//! makes an entry before an interface takes frames, and that only the CPU's own runs write.
//! `SEQUENCE` tells frames apart.
//!
//! A copy that nobody needs is dropped, but for the last at its interface. The kernel sends up to
//! 16 frames at a time, and if it is left with none of the last ones it does not tell the driver
//! that there were others before: those would wait for the next frame. So the last copy leaves in
//! any case, as a filler if need be.

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

/// No interface has a group address of its own, so no frame that leaves otherwise has this in its
/// source.
const MARK: u16 = 0xffff;

/// What a copy is for, in the place of the Ethernet addresses.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Label {
    /// The low 48 bits of the number of the frame on this CPU.
    sequence: [u16; 3],
    mark: u16,
    group: u16,
    zero: u16,
}

const _: () = assert!(size_of::<Label>() <= ETHERNET_LEN);

/// Labels a frame that is about to be copied; `false` if that cannot be.
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
    /// The label of a packet, if that is a copy.
    #[inline(always)]
    pub fn of(packet: &Packet) -> Option<Self> {
        // SAFETY: `get` checked the bounds, and any bytes are a label.
        packet.get::<Self>(0).map(|label| unsafe { *label }).filter(|label| label.mark == MARK)
    }

    /// Which of the copies this is, that now leaves by `interface`. To be asked once for each.
    #[inline(always)]
    pub fn slot(&self, interface: u32) -> Option<GroupSlot> {
        let [low, middle, high] = self.sequence.map(u64::from);
        let sequence = low | middle << 16 | high << 32;
        // SAFETY: this CPU's part of an element that stays while its interface takes frames; nobody
        // else writes it.
        let counted = unsafe { &mut *COUNTED.get_ptr_mut(interface)? };
        let index = if counted.sequence == sequence { counted.copies } else { 0 };
        *counted = CopyCount { sequence, copies: index + 1, ..*counted };
        Some(GroupSlot { group: self.group.into(), interface, index })
    }
}

/// Says that a copy is dropped because nobody needs it.
#[inline(always)]
pub fn count_superfluous(interface: u32) {
    if let Some(counted) = COUNTED.get_ptr_mut(interface) {
        // SAFETY: this CPU's part of an element, as above.
        unsafe { (*counted).superfluous += 1 };
    }
}

/// How many were said since this was last asked.
#[inline(always)]
pub fn take_superfluous(interface: u32) -> u64 {
    let Some(counted) = COUNTED.get_ptr_mut(interface) else { return 0 };
    // SAFETY: this CPU's part of an element, as above.
    unsafe { core::mem::take(&mut (*counted).superfluous).into() }
}

/// Turns a copy into the shortest frame there is, with nothing of the copy in it. No bridge
/// forwards it (IEEE 802.1Q, reserved group address). No host takes it (IEEE 802, local
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
