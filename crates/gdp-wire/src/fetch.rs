//! Prefetching of memory.

/// Prefetches the cache line of an address without waiting. The address need not be mapped. Works
/// on x86-64 and AArch64; a no-op elsewhere.
#[inline(always)]
pub fn fetch<T>(line: *const T) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: changes nothing but the caches, never faults, and every x86-64 processor supports it.
    unsafe {
        use core::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(line.cast());
    }
    #[cfg(target_arch = "aarch64")]
    // SAFETY: changes nothing but the caches, never faults, and every AArch64 processor supports
    // it.
    unsafe {
        core::arch::asm!("prfm pldl1keep, [{}]", in(reg) line, options(nostack, readonly, preserves_flags));
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = line;
}
