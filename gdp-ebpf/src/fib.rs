//! Where names and egress bits lead. Written by user space only.
//!
//! `FIB` is a preallocated hash and never an LRU: a FIB does not forget. The kernel replaces an entry by linking a new
//! element, so a reader sees an old or a new entry; a removed element may be reused while a reader still holds it, and
//! what such a frame then gets is a route of another name: the one frame goes to an endpoint that cannot open it.
//! `NEXT_HOP` is one word per egress bit.
//!
//! `PERMITS` is a set: only whether a key is there counts. Few names have more than one writer at a switch, so its elements are
//! allocated as they are needed. A permit is there before the entry that says to look for it, and goes after.

use aya_ebpf::bindings::BPF_F_NO_PREALLOC;
use aya_ebpf::macros::map;
use aya_ebpf::maps::{Array, HashMap};
use gdp_wire::table::EGRESS_SET_SIZE;
use gdp_wire::{FibEntry, Name, Permit};

/// User space sets the real capacity when it loads the object.
#[map]
static FIB: HashMap<Name, FibEntry> = HashMap::with_max_entries(1024, 0);

/// The values say nothing. The same capacity as the FIB.
#[map]
static PERMITS: HashMap<Permit, u32> = HashMap::with_max_entries(1024, BPF_F_NO_PREALLOC);

#[map]
static NEXT_HOP: Array<u32> = Array::with_max_entries(EGRESS_SET_SIZE, 0);

#[inline(always)]
pub fn route(name: &Name) -> Option<FibEntry> {
    // SAFETY: elements are preallocated, so the memory stays a `FibEntry` for the life of the map; see above for what
    // a racing removal means.
    FIB.get_ptr(name).map(|entry| unsafe { *entry })
}

#[inline(always)]
pub fn is_permitted(permit: &Permit) -> bool {
    PERMITS.get_ptr(permit).is_some()
}

#[inline(always)]
pub fn next_hop(bit: u32) -> u32 {
    NEXT_HOP.get(bit).copied().unwrap_or(0)
}
