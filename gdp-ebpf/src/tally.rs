//! What became of the frames of each link, and which names are the busiest. Written here only, by
//! the CPU that owns the slot, as the counters are; user space reads and sums, and clears the row
//! of a link before it writes a new one there.
//!
//! Of the frames that leave, one in [`SAMPLING`] is counted for its name, chosen by its hop tag,
//! which nobody but the neighbour can steer. Here a map may forget: the least recently seen name
//! makes room.

use aya_ebpf::bindings::BPF_ANY;
use aya_ebpf::macros::map;
use aya_ebpf::maps::{LruPerCpuHashMap, PerCpuArray};
use gdp_wire::counter::{BUSIEST_NAMES, is_sampled};
use gdp_wire::table::{MAX_LINKS, link_index};
use gdp_wire::{Counter, Header, Name};

#[map]
static LINK_COUNTERS: PerCpuArray<[u64; Counter::COUNT]> = PerCpuArray::with_max_entries(MAX_LINKS, 0);

#[map]
static BUSIEST: LruPerCpuHashMap<Name, u64> = LruPerCpuHashMap::with_max_entries(BUSIEST_NAMES, 0);

/// Counts a frame that came in on a link. Nothing is counted for ids that no link has.
#[inline(always)]
pub fn count_arrival(link: u32, counter: Counter) {
    if counter.is_before_link() {
        return;
    }
    if let Some(row) = LINK_COUNTERS.get_ptr_mut(link_index(link)) {
        // SAFETY: this CPU's slot, which nobody else writes.
        unsafe { (*row)[counter as usize] += 1 }
    }
}

/// Counts the name of a frame that leaves, if it is one of those that are looked at.
#[inline(always)]
pub fn sample(tag: u64, header: &Header) {
    if !is_sampled(tag) {
        return;
    }
    match BUSIEST.get_ptr_mut(header.destination) {
        // SAFETY: this CPU's value; that the element is reused meanwhile costs at most this count.
        Some(count) => unsafe { *count += 1 },
        None => _ = BUSIEST.insert(header.destination, 1, BPF_ANY.into()),
    }
}
