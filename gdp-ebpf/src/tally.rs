//! The frame counts of each link, and the busiest names. Only these programs write, on the CPU that
//! owns the slot, as for the counters. User space reads and sums. It clears the row of a link
//! before it writes a new link with that index.
//!
//! Of the frames that leave, one in [`SAMPLING`] is counted for its name. The hop tag of the frame
//! selects it, which only the neighbour can influence. This map may evict entries: the least
//! recently seen name goes first.

use aya_ebpf::bindings::BPF_ANY;
use aya_ebpf::macros::map;
use aya_ebpf::maps::{LruPerCpuHashMap, PerCpuArray};
use gdp_wire::counter::{BUSIEST_NAMES, is_sampled};
use gdp_wire::table::{MAX_LINKS, link_index};
use gdp_wire::{Counter, Header, Name};

use crate::opaque::opaque;

#[map]
static LINK_COUNTERS: PerCpuArray<[u64; Counter::COUNT]> = PerCpuArray::with_max_entries(MAX_LINKS, 0);

#[map]
static BUSIEST: LruPerCpuHashMap<Name, u64> = LruPerCpuHashMap::with_max_entries(BUSIEST_NAMES, 0);

/// Counts a frame that arrived on a link. Frames with an unknown link id are not counted.
#[inline(always)]
pub fn count_arrival(link: u32, counter: Counter) {
    if counter.is_before_link() {
        return;
    }
    if let Some(row) = LINK_COUNTERS.get_ptr_mut(link_index(link)) {
        // SAFETY: this CPU's slot, which no other CPU writes.
        let row = unsafe { &mut *row };
        if let Some(count) = row.get_mut(opaque(counter as usize)) {
            *count += 1;
        }
    }
}

/// Counts the name of a frame that leaves, if the frame is in the sample.
#[inline(always)]
pub fn sample(tag: u64, header: &Header) {
    if !is_sampled(tag) {
        return;
    }
    match BUSIEST.get_ptr_mut(header.destination) {
        // SAFETY: this CPU's value. If the element is reused concurrently, at most this count is
        // lost.
        Some(count) => unsafe { *count += 1 },
        None => _ = BUSIEST.insert(header.destination, 1, BPF_ANY.into()),
    }
}
