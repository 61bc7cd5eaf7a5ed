//! Keeps the number of states small that the kernel's verifier explores.
//!
//! The verifier follows every path through a program. Two paths that meet count as one from there
//! on if they agree in all that later code depends on. A constant that a path has chosen, such as a
//! counter or an offset, keeps them apart. Where many paths meet, [`join`] therefore makes such
//! values unknown to the verifier. Code after that is verified once, not once for each path.
//!
//! The other means is a global function, which the verifier checks by itself. See
//! [`crate::fib::route`].

/// Returns `value`, which the verifier no longer knows. `unknown` is any word that it does not know
/// either, such as one of the packet. `V` has at most 8 bytes, and no padding.
#[cfg(target_arch = "bpf")]
#[inline(always)]
pub fn join<V: Copy>(value: V, unknown: u64) -> V {
    use core::mem::transmute_copy;
    const { assert!(size_of::<V>().is_power_of_two() && size_of::<V>() <= 8) };
    // SAFETY: the same bits as an integer of the same size, and back.
    unsafe {
        match size_of::<V>() {
            1 => transmute_copy(&(twice_exclusive(transmute_copy::<V, u8>(&value).into(), unknown) as u8)),
            2 => transmute_copy(&(twice_exclusive(transmute_copy::<V, u16>(&value).into(), unknown) as u16)),
            4 => transmute_copy(&(twice_exclusive(transmute_copy::<V, u32>(&value).into(), unknown) as u32)),
            _ => transmute_copy(&twice_exclusive(transmute_copy::<V, u64>(&value), unknown)),
        }
    }
}

/// Returns `value ^ unknown ^ unknown`. The compiler would simplify it; the verifier does not.
#[cfg(target_arch = "bpf")]
#[inline(always)]
fn twice_exclusive(mut value: u64, unknown: u64) -> u64 {
    // SAFETY: changes one register only.
    unsafe {
        core::arch::asm!(
            "{value} ^= {unknown}",
            "{value} ^= {unknown}",
            value = inout(reg) value,
            unknown = in(reg) unknown,
            options(pure, nomem, nostack),
        );
    }
    value
}

/// The host version.
#[cfg(not(target_arch = "bpf"))]
pub fn join<V: Copy>(value: V, _unknown: u64) -> V {
    value
}
