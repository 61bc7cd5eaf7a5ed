//! The replay windows of all links. Shared with the userspace plane, which maps them: frames of a
//! link may arrive at either plane.
//!
//! The kernel and user space change every word by compare-exchange only. The only exception: user
//! space clears the window of a new link before it writes the link. A program processes a frame to
//! the end on one CPU within microseconds. An index is not reused until 1023 others have been used,
//! so no frame of a removed link meets the window of its successor. `gdp_wire::replay` describes
//! concurrent accesses to one window.

use aya_ebpf::bindings::BPF_F_MMAPABLE;
use aya_ebpf::macros::map;
use aya_ebpf::maps::Array;
use gdp_wire::LinkEntry;
use gdp_wire::replay::{WORDS, Words};
use gdp_wire::table::{MAX_LINKS, link_index};

#[map]
static WINDOWS: Array<[u64; WORDS]> = Array::with_max_entries(MAX_LINKS, BPF_F_MMAPABLE);

/// The window of a link: the first word of an element of the map.
pub struct Window(*mut u64);

#[inline(always)]
pub fn get(link: &LinkEntry) -> Option<Window> {
    WINDOWS.get_ptr_mut(link_index(link.id)).map(|window| Window(window.cast()))
}

impl Words for Window {
    #[inline(always)]
    fn load(&self, index: usize) -> u64 {
        // SAFETY: within the element, whose memory remains valid. Aligned. The kernel's JIT emits
        // one load.
        unsafe { self.0.add(index).read_volatile() }
    }

    #[inline(always)]
    fn compare_exchange(&self, index: usize, current: u64, new: u64) -> u64 {
        // SAFETY: within the element, whose memory remains valid. Aligned. All accesses are atomic.
        unsafe { compare_exchange(self.0.add(index), current, new) }
    }
}

/// Writes `new` to `*word` atomically if `*word` is `current`. Returns the previous value. See
/// `links::fetch_add`.
///
/// # Safety
///
/// `word` must be valid and aligned, and all its accesses must be atomic.
#[cfg(target_arch = "bpf")]
#[inline(always)]
unsafe fn compare_exchange(word: *mut u64, current: u64, new: u64) -> u64 {
    let found;
    // SAFETY: the caller's promise; the instruction touches only `*word` and the register.
    unsafe {
        core::arch::asm!(
            "r0 = cmpxchg_64({word} + 0, r0, {new})",
            word = in(reg) word,
            new = in(reg) new,
            inout("r0") current => found,
        );
    }
    found
}

/// The host version.
///
/// # Safety
///
/// As above.
#[cfg(not(target_arch = "bpf"))]
unsafe fn compare_exchange(word: *mut u64, current: u64, new: u64) -> u64 {
    use core::sync::atomic::{AtomicU64, Ordering};
    // SAFETY: the caller's promise.
    let word = unsafe { AtomicU64::from_ptr(word) };
    word.compare_exchange(current, new, Ordering::Relaxed, Ordering::Relaxed).unwrap_or_else(|found| found)
}
