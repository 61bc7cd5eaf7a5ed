//! What has arrived on each link. Shared with the userspace plane, which maps it: frames of a link
//! may come to either.
//!
//! Every word is changed by compare-exchange only, in the kernel and in user space, except that
//! user space clears the window of a link that is new, before it writes the link. A frame runs to
//! its end on one CPU and is over within microseconds; an index rests while 1023 others are used,
//! so no frame of a link that is gone meets a window of the next. What several CPUs may do to one
//! window at once is in `gdp_wire::replay`.

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
        // SAFETY: within the element, whose memory stays; aligned; the kernel's JIT makes one load
        // of it.
        unsafe { self.0.add(index).read_volatile() }
    }

    #[inline(always)]
    fn compare_exchange(&self, index: usize, current: u64, new: u64) -> u64 {
        // SAFETY: within the element, whose memory stays; aligned; everybody accesses it
        // atomically.
        unsafe { compare_exchange(self.0.add(index), current, new) }
    }
}

/// Writes `new` to `*word` if that is `current`, atomically, and returns what it was. See
/// `links::fetch_add`.
///
/// # Safety
///
/// `word` must be valid, aligned, and accessed atomically by everybody.
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

/// On the host.
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
