//! The next hops of egress bits: one link id per bit, written by user space only.

use aya_ebpf::macros::map;
use aya_ebpf::maps::Array;
use gdp_wire::table::EGRESS_SET_SIZE;

#[map]
static NEXT_HOP: Array<u32> = Array::with_max_entries(EGRESS_SET_SIZE, 0);

#[inline(always)]
pub fn next_hop(bit: u32) -> u32 {
    NEXT_HOP.get(bit).copied().unwrap_or(0)
}
