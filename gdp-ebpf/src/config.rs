//! What the switch knows of itself. Written whole by user space before the programs attach and when
//! the RIB assigns the own bit; the two words in it are each read once, so a racing reader sees
//! either an old or a new one.

use aya_ebpf::macros::map;
use aya_ebpf::maps::Array;
use gdp_wire::{ETHERTYPE, SwitchConfig};

#[map]
static CONFIG: Array<SwitchConfig> = Array::with_max_entries(1, 0);

#[inline(always)]
pub fn get() -> SwitchConfig {
    match CONFIG.get(0) {
        Some(config) => *config,
        // Not reachable: an array of one entry has entry 0. The verifier wants it said.
        None => SwitchConfig { own_bit: 0, ethertype: ETHERTYPE as u32, host_pair: 0 },
    }
}
