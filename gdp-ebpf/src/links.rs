//! The switch's links. Only user space writes `LINKS`, whole entries at a time. User space writes a
//! link before any route leads to the link, and removes the link after the last such route. A frame
//! that races with the first write of an entry fails the tag check or finds no link.
//!
//! The keys of a link change in two writes while its id stays the same. The first writes a key that
//! no frame is tagged with yet. The second, at least a round trip later, changes the phase to that
//! key. A program that reads during the kernel's copy therefore sees one of the two phases, and a
//! complete key for either.
//!
//! `TX_COUNTERS` is shared with the userspace plane, which maps it: both planes use one sequence of
//! counters per link. Both sides therefore access the counters by atomic addition only.
//!
//! `COMPLAINTS` and `PUNTS` are shared in the same manner. Two racing writers store nearly the same
//! time; the neighbour then gets one more error, or the daemon one more probe. Only user space
//! writes `PUNTS`, because probes reach the daemon there.

use aya_ebpf::bindings::BPF_F_MMAPABLE;
use aya_ebpf::helpers::bpf_ktime_get_coarse_ns;
use aya_ebpf::macros::map;
use aya_ebpf::maps::Array;
use gdp_wire::LinkEntry;
use gdp_wire::table::{COMPLAINT_INTERVAL_NS, MAX_LINKS, PUNT_INTERVAL_NS, link_index};

#[map]
static LINKS: Array<LinkEntry> = Array::with_max_entries(MAX_LINKS, 0);

/// Number of frames sent on the link with the same index. Frames carry the low 32 bits.
#[map]
static TX_COUNTERS: Array<u64> = Array::with_max_entries(MAX_LINKS, BPF_F_MMAPABLE);

/// Time of the last error sent on the link with the same index, in nanoseconds of the monotonic
/// clock.
#[map]
static COMPLAINTS: Array<u64> = Array::with_max_entries(MAX_LINKS, BPF_F_MMAPABLE);

/// Time of the last probe that the daemon received from the link with the same index, on the same
/// clock.
#[map]
static PUNTS: Array<u64> = Array::with_max_entries(MAX_LINKS, BPF_F_MMAPABLE);

#[inline(always)]
pub fn get(id: u32) -> Option<&'static LinkEntry> {
    // SAFETY: array elements are valid as long as the map.
    let link = unsafe { &*LINKS.get_ptr(link_index(id))? };
    (link.id == id && id != 0).then_some(link)
}

#[inline(always)]
pub fn next_count(link: &LinkEntry) -> u64 {
    match TX_COUNTERS.get_ptr_mut(link_index(link.id)) {
        // SAFETY: a live, aligned element of the map; all accesses are atomic.
        Some(slot) => unsafe { fetch_add(slot, 1) }.wrapping_add(1),
        None => 0,
    }
}

#[inline(always)]
pub fn may_send_error(link: &LinkEntry) -> bool {
    let Some(last) = COMPLAINTS.get_ptr_mut(link_index(link.id)) else { return false };
    // SAFETY: a helper without arguments, and a live, aligned element of the map. The kernel's JIT
    // emits one load.
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
        // SAFETY: as above; the kernel's JIT emits one store.
        unsafe { last.write_volatile(bpf_ktime_get_coarse_ns()) }
    }
}

/// Adds to `*slot` atomically and returns the previous value. The compiler's target description
/// lacks this instruction; the kernel supports it since 5.12.
///
/// # Safety
///
/// `slot` must be valid and aligned, and all its accesses must be atomic.
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

/// The host version.
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
