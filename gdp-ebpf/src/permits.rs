//! The names that frames of a link may have in their headers, beyond those that links and routes
//! allow. The map is a set; the values are unused. Few names need a permit, so elements are
//! allocated on demand. Only user space writes: it adds a permit before the FIB entry that refers
//! to it, and removes the permit after that entry.

use aya_ebpf::bindings::BPF_F_NO_PREALLOC;
use aya_ebpf::macros::map;
use aya_ebpf::maps::HashMap;
use gdp_wire::Permit;

/// User space sets the real capacity when it loads the object: the maximum number of names. The
/// values are unused.
#[map]
static PERMITS: HashMap<Permit, u32> = HashMap::with_max_entries(1024, BPF_F_NO_PREALLOC);

#[inline(always)]
pub fn is_permitted(permit: &Permit) -> bool {
    PERMITS.get_ptr(permit).is_some()
}
