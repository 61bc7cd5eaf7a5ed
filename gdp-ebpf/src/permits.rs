//! Which names the frames of a link may have in their headers beyond what links and routes say. A
//! set: only whether a key is there counts. Few names need one, so elements are allocated as they
//! are needed. Written by user space only: a permit is there before the FIB entry that says to look
//! for it, and goes after.

use aya_ebpf::bindings::BPF_F_NO_PREALLOC;
use aya_ebpf::macros::map;
use aya_ebpf::maps::HashMap;
use gdp_wire::Permit;

/// The values say nothing. User space sets the real capacity when it loads the object: as many as
/// there may be names.
#[map]
static PERMITS: HashMap<Permit, u32> = HashMap::with_max_entries(1024, BPF_F_NO_PREALLOC);

#[inline(always)]
pub fn is_permitted(permit: &Permit) -> bool {
    PERMITS.get_ptr(permit).is_some()
}
