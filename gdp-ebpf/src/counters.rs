//! One count per [`Counter`] and CPU. Only these programs write a slot, on the CPU that owns it.
//! XDP programs do not preempt each other on a CPU, so a plain increment is safe. User space only
//! reads and sums.

use aya_ebpf::macros::map;
use aya_ebpf::maps::PerCpuArray;
use gdp_wire::Counter;

#[map]
static COUNTERS: PerCpuArray<u64> = PerCpuArray::with_max_entries(Counter::COUNT as u32, 0);

#[inline(always)]
pub fn count(counter: Counter) {
    add(counter, 1);
}

#[inline(always)]
pub fn add(counter: Counter, frames: u64) {
    if let Some(slot) = COUNTERS.get_ptr_mut(counter as u32) {
        // SAFETY: the kernel returned a pointer to this CPU's slot, which no other CPU writes.
        unsafe { *slot += frames }
    }
}
