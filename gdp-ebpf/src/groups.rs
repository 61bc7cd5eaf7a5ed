//! Groups of links that frames are copied to. A group is a device map with one key for each copy
//! that the kernel is to make, and the places that say which link gets which. Written by user space
//! only, but for [`suspend`].
//!
//! `SERVED` says which egress bits the kernel can copy frames for: its links that those lead to are
//! all in the group. Of a link over UDP user space has asked by which interface it leaves. When a
//! copy finds that this is not so any more (the route changed, or the neighbour is to be resolved
//! anew) it is lost, and the group is suspended: until user space has asked again the frames are
//! left to the userspace plane.
//!
//! A group that is in use changes only so that nobody else in it misses a frame or gets it twice: a
//! link that goes leaves its place empty, one that comes takes an empty place or a new one behind
//! the others; a key comes after its place is taken, and goes after that is empty. Keys of one
//! interface are all the same to the kernel. A group that takes the number of another is written
//! anew only when no frame is under way to that: after it served nobody for an RCU grace period,
//! which no run of these programs outlasts.

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

/// Values are link ids. Most groups are small, so elements are allocated as they are needed.
#[map]
static SLOTS: HashMap<GroupSlot, u32> = HashMap::with_max_entries(MAX_GROUPS * MAX_COPIES, BPF_F_NO_PREALLOC);

/// The egress bits that the kernel can copy frames for; this switch's own bit is that of the local
/// readers.
#[inline(always)]
pub fn served(group: u32) -> u64 {
    SERVED.get(group).copied().unwrap_or(0)
}

/// Leaves the frames for a group to the userspace plane, until user space says which it is to copy.
#[inline(always)]
pub fn suspend(group: u32) {
    if let Some(served) = SERVED.get_ptr_mut(group) {
        // SAFETY: a live, aligned element of the map, that is written only whole, as the kernel's
        // JIT makes it.
        unsafe { served.write_volatile(0) };
    }
}

/// Makes the copies when the program returns, of which each runs through the program at its
/// interface; `false` if there is no such group.
#[inline(always)]
pub fn redirect(group: u32) -> bool {
    const BROADCAST: u64 = 1 << 3;
    GROUPS.get(group).is_some_and(|keys| keys.redirect(0, BROADCAST).is_ok())
}

/// The link that gets this copy.
#[inline(always)]
pub fn link_at(slot: &GroupSlot) -> Option<u32> {
    // SAFETY: the value is read at once; an element that is freed meanwhile stays readable until
    // the program ends, as an id of a link that then is another's or nobody's: the copy is of the
    // same name, and for it as for any reader just gone.
    SLOTS.get_ptr(slot).map(|link| unsafe { *link })
}
