//! Who else may send to a name. A set: only whether a key is there counts. Few names have more than one writer at a switch, so elements
//! are allocated as they are needed. Written by user space only: a permit is there before the FIB entry that says to look for it,
//! and goes after.

use aya_ebpf::bindings::BPF_F_NO_PREALLOC;
use aya_ebpf::macros::map;
use aya_ebpf::maps::HashMap;
use gdp_wire::{LinkEntry, Name, Permit};

/// The values say nothing. User space sets the real capacity when it loads the object: as many as there may be names.
#[map]
static PERMITS: HashMap<Permit, u32> = HashMap::with_max_entries(1024, BPF_F_NO_PREALLOC);

#[inline(always)]
pub fn is_permitted(link: &LinkEntry, name: &Name) -> bool {
    PERMITS.get_ptr(Permit { name: *name, link: link.id, reserved: 0 }).is_some()
}
