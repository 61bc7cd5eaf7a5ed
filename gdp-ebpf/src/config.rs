//! The configuration of the switch. User space writes the whole entry before the programs attach,
//! and again when the RIB assigns the own bit. Each word is read once, so a racing reader gets
//! either the old or the new value.

use aya_ebpf::macros::map;
use aya_ebpf::maps::Array;
use gdp_wire::{ETHERTYPE, SwitchConfig};

#[map]
static CONFIG: Array<SwitchConfig> = Array::with_max_entries(1, 0);

#[inline(always)]
pub fn get() -> SwitchConfig {
    match CONFIG.get(0) {
        Some(config) => *config,
        // Unreachable: an array of one entry has entry 0. The verifier requires the case.
        None => SwitchConfig { own_bit: 0, ethertype: ETHERTYPE as u32, host_pair: 0 },
    }
}
