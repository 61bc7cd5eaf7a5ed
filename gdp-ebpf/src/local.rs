//! The addresses and VLANs whose frames the switch takes, in addition to untagged GDP frames. Only
//! user space writes them: it adds an element before the first link that needs it, and removes it
//! after the last. Both maps are sets; the values are unused.

use aya_ebpf::bindings::BPF_F_NO_PREALLOC;
use aya_ebpf::macros::map;
use aya_ebpf::maps::HashMap;
use gdp_wire::table::{MAX_LOCAL_ADDRESSES, MAX_PORTS};
use gdp_wire::{LocalAddress, Vlan};

/// The addresses of the daemon's socket for frames over UDP.
#[map]
static ADDRESSES: HashMap<LocalAddress, u32> = HashMap::with_max_entries(MAX_LOCAL_ADDRESSES, BPF_F_NO_PREALLOC);

/// The VLANs that GDP runs on.
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
