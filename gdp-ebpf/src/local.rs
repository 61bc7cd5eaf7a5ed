//! What on the interfaces is ours beside untagged GDP frames. Written by user space only, an
//! element before the first link that needs it, and removed after the last. Only whether a key is
//! there counts.

use aya_ebpf::bindings::BPF_F_NO_PREALLOC;
use aya_ebpf::macros::map;
use aya_ebpf::maps::HashMap;
use gdp_wire::table::{MAX_LOCAL_ADDRESSES, MAX_PORTS};
use gdp_wire::{LocalAddress, Vlan};

/// Where the daemon's socket takes frames over UDP.
#[map]
static ADDRESSES: HashMap<LocalAddress, u32> = HashMap::with_max_entries(MAX_LOCAL_ADDRESSES, BPF_F_NO_PREALLOC);

/// Where GDP runs on a VLAN.
#[map]
static VLANS: HashMap<Vlan, u32> = HashMap::with_max_entries(MAX_PORTS, BPF_F_NO_PREALLOC);

#[inline(always)]
pub fn is_ours(address: &LocalAddress) -> bool {
    ADDRESSES.get_ptr(address).is_some()
}

#[inline(always)]
pub fn is_our_vlan(vlan: &Vlan) -> bool {
    VLANS.get_ptr(vlan).is_some()
}
