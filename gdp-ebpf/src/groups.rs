//! Groups of links that frames are copied to. A group consists of a device map with one key per
//! copy, and slots that assign a link to each copy. Written by user space only, except by
//! [`suspend`].
//!
//! `SERVED` contains the egress bits that the kernel can copy frames for. All links of the switch
//! that lead to these bits are in the group. For a link over UDP, user space has looked up the
//! egress interface in the kernel's routing table. A copy is lost if this interface is no longer
//! right, because the route changed or the neighbour is unresolved. The egress program then
//! suspends the group. The userspace plane forwards the frames of the group until user space has
//! repeated the lookup.
//!
//! Changes to a group in use never make another member miss a frame or receive a frame twice:
//!
//! - A link that leaves the group leaves its slot empty. A link that joins takes an empty slot, or
//!   a new slot after the others.
//! - User space adds a key after its slot is filled, and removes a key after its slot is empty. The
//!   kernel does not distinguish the keys of one interface.
//! - User space reuses a group number only when no frame to the old group is in flight. The old
//!   group must have served no bits for an RCU grace period, which no run of these programs
//!   outlasts.

use aya_ebpf::bindings::BPF_F_NO_PREALLOC;
use aya_ebpf::btf_maps::{ArrayOfMaps, DevMapHash};
use aya_ebpf::macros::{btf_map, map};
use aya_ebpf::maps::{Array, HashMap};
use gdp_wire::GroupSlot;
use gdp_wire::table::{MAX_COPIES, MAX_GROUPS};

#[btf_map]
static GROUPS: ArrayOfMaps<DevMapHash<{ MAX_COPIES as usize }>, { MAX_GROUPS as usize }> = ArrayOfMaps::new();

#[map]
static SERVED: Array<u64> = Array::with_max_entries(MAX_GROUPS, 0);

/// Maps a slot to a link id. Most groups are small, so elements are allocated on demand.
#[map]
static SLOTS: HashMap<GroupSlot, u32> = HashMap::with_max_entries(MAX_GROUPS * MAX_COPIES, BPF_F_NO_PREALLOC);

/// Returns the egress bits that the kernel can copy frames for. This switch's own bit stands for
/// the local readers.
#[inline(always)]
pub fn served(group: u32) -> u64 {
    SERVED.get(group).copied().unwrap_or(0)
}

/// Hands the frames of a group to the userspace plane until user space writes `SERVED` again.
#[inline(always)]
pub fn suspend(group: u32) {
    if let Some(served) = SERVED.get_ptr_mut(group) {
        // SAFETY: a live, aligned element of the map. All writers write the whole word, in one
        // store of the kernel's JIT.
        unsafe { served.write_volatile(0) };
    }
}

/// Makes the copies when the program returns. Each copy runs through the program at its interface.
/// Returns `false` if the group does not exist.
#[inline(always)]
pub fn redirect(group: u32) -> bool {
    const BROADCAST: u64 = 1 << 3;
    GROUPS.get(group).is_some_and(|keys| keys.redirect(0, BROADCAST).is_ok())
}

/// Returns the link of this copy.
#[inline(always)]
pub fn link_at(slot: &GroupSlot) -> Option<u32> {
    // SAFETY: the value is read at once. An element that is freed concurrently remains readable
    // until the program ends, and may then contain the id of another link or of no link. The copy
    // is of the same name, so the result is the same as for a reader that has just left.
    SLOTS.get_ptr(slot).map(|link| unsafe { *link })
}
