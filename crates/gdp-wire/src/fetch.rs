//! Asking the CPU for memory before it is needed.

/// Brings the cache line at an address into the caches, without waiting for it; whether there is
/// anything does not matter. On x86-64 and AArch64; elsewhere it does nothing.
#[inline(always)]
pub fn fetch<T>(line: *const T) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: changes nothing but the caches, faults nowhere, and every x86-64 processor has it.
    unsafe {
        use core::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(line.cast());
    }
    #[cfg(target_arch = "aarch64")]
    // SAFETY: changes nothing but the caches, faults nowhere, and every AArch64 processor has it.
    unsafe {
        core::arch::asm!("prfm pldl1keep, [{}]", in(reg) line, options(nostack, readonly, preserves_flags));
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = line;
}
