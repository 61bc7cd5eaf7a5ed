//! Values that the compiler does not know.

/// Returns `value`, which the compiler no longer knows. The compiler then retains bounds checks
/// that only the verifier needs, and one register for the value.
#[inline(always)]
pub fn opaque(mut value: usize) -> usize {
    // SAFETY: adds zero to a register. An instruction is necessary, because the kernel refuses two
    // source lines for one.
    #[cfg(target_arch = "bpf")]
    unsafe {
        core::arch::asm!("{value} += 0", value = inout(reg) value, options(pure, nomem, nostack));
    }
    #[cfg(not(target_arch = "bpf"))]
    let _ = &mut value;
    value
}

/// Returns zero, which the compiler does not know. It makes filling memory with a known zero a call
/// of a function that writes byte by byte.
#[inline(always)]
pub fn zero() -> u64 {
    opaque(0) as u64
}
