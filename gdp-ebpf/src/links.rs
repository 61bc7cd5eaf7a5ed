//! The switch's links. `LINKS` is written by user space only, whole entries: a link is written
//! before any route leads to it and removed after. A frame that races with the first write of an
//! entry fails its tag or finds no link.
//!
//! While its id stays, a link's keys change in two writes: first a key that no frame is tagged
//! with, then, a round trip or more later, the phase that points to it. So a program that reads
//! while the kernel copies finds one phase or the other, and the key of either whole.
//!
//! `TX_COUNTERS` is shared with the userspace plane, which maps it: a link has one sequence of
//! counters, whichever plane sends. Hence atomic additions, and nothing else, on both sides.
//!
//! `COMPLAINTS` and `PUNTS` are shared likewise. Two that race write nearly the same time, and the
//! link gets one error more, or the daemon one probe. The second is written by user space only,
//! which is where probes get to the daemon.

use aya_ebpf::bindings::BPF_F_MMAPABLE;
use aya_ebpf::helpers::bpf_ktime_get_coarse_ns;
use aya_ebpf::macros::map;
use aya_ebpf::maps::Array;
use gdp_wire::LinkEntry;
use gdp_wire::table::{COMPLAINT_INTERVAL_NS, MAX_LINKS, PUNT_INTERVAL_NS, link_index};

#[map]
static LINKS: Array<LinkEntry> = Array::with_max_entries(MAX_LINKS, 0);

/// The count of frames sent by the link with the same index, of which frames carry the low 32 bits.
#[map]
static TX_COUNTERS: Array<u64> = Array::with_max_entries(MAX_LINKS, BPF_F_MMAPABLE);

/// When the last error left by the link with the same index, in nanoseconds of the monotonic clock.
#[map]
static COMPLAINTS: Array<u64> = Array::with_max_entries(MAX_LINKS, BPF_F_MMAPABLE);

/// When the daemon was last given a probe that came on the link with the same index, likewise.
#[map]
static PUNTS: Array<u64> = Array::with_max_entries(MAX_LINKS, BPF_F_MMAPABLE);

#[inline(always)]
pub fn get(id: u32) -> Option<&'static LinkEntry> {
    // SAFETY: array elements live as long as the map.
    let link = unsafe { &*LINKS.get_ptr(link_index(id))? };
    (link.id == id && id != 0).then_some(link)
}

#[inline(always)]
pub fn next_count(link: &LinkEntry) -> u64 {
    match TX_COUNTERS.get_ptr_mut(link_index(link.id)) {
        // SAFETY: a live, aligned element of the map, only ever accessed atomically.
        Some(slot) => unsafe { fetch_add(slot, 1) }.wrapping_add(1),
        None => 0,
    }
}

#[inline(always)]
pub fn may_send_error(link: &LinkEntry) -> bool {
    let Some(last) = COMPLAINTS.get_ptr_mut(link_index(link.id)) else { return false };
    // SAFETY: a helper without arguments, and a live, aligned element of the map; the kernel's JIT
    // makes one load.
    unsafe { bpf_ktime_get_coarse_ns().wrapping_sub(last.read_volatile()) >= COMPLAINT_INTERVAL_NS }
}

#[inline(always)]
pub fn may_punt(link: &LinkEntry) -> bool {
    let Some(last) = PUNTS.get_ptr(link_index(link.id)) else { return false };
    // SAFETY: as above.
    unsafe { bpf_ktime_get_coarse_ns().wrapping_sub(last.read_volatile()) >= PUNT_INTERVAL_NS }
}

#[inline(always)]
pub fn send_error(link: &LinkEntry) {
    if let Some(last) = COMPLAINTS.get_ptr_mut(link_index(link.id)) {
        // SAFETY: as above; the kernel's JIT makes one store.
        unsafe { last.write_volatile(bpf_ktime_get_coarse_ns()) }
    }
}

/// Adds to `*slot` atomically and returns what it was. The compiler's description of the target
/// says it has no such instruction; the kernel has it since 5.12.
///
/// # Safety
///
/// `slot` must be valid, aligned, and accessed atomically by everybody.
#[cfg(target_arch = "bpf")]
#[inline(always)]
unsafe fn fetch_add(slot: *mut u64, mut value: u64) -> u64 {
    // SAFETY: the caller's promise; the instruction touches only `*slot` and the register.
    unsafe {
        core::arch::asm!("{value} = atomic_fetch_add((u64 *)({slot} + 0), \
                          {value})", slot = in(reg) slot, value = inout(reg) value);
    }
    value
}

/// On the host.
///
/// # Safety
///
/// As above.
#[cfg(not(target_arch = "bpf"))]
unsafe fn fetch_add(slot: *mut u64, value: u64) -> u64 {
    use core::sync::atomic::{AtomicU64, Ordering};
    // SAFETY: the caller's promise.
    unsafe { AtomicU64::from_ptr(slot) }.fetch_add(value, Ordering::Relaxed)
}
