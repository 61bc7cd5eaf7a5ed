//! Numbered names and routes for `bench forward` and for the FIB tests in the kernel. The programs
//! and user space, which includes this file by its path, must compute the same values.

/// Returns the four words of the name with this number.
#[inline(always)]
pub const fn name(number: u64) -> [u64; 4] {
    let a = mix(number.wrapping_add(0x9e37_79b9_7f4a_7c15));
    [a, a.wrapping_mul(0x9e37_79b9_7f4a_7c15), a ^ 0x5555_5555_5555_5555, !a]
}

/// Returns a route of the name with this number; every `version` is a different route.
#[inline(always)]
pub const fn route(number: u64, version: u64) -> [u64; 3] {
    [version, number ^ version.rotate_left(32), !version]
}

/// Returns whether `route` is a route of the name with this number, of any version.
#[inline(always)]
pub const fn is_route(number: u64, route: [u64; 3]) -> bool {
    let [version, both, inverse] = route;
    (both ^ number ^ version.rotate_left(32)) | (inverse ^ !version) == 0
}

/// The finalizer of SplitMix64.
#[inline(always)]
const fn mix(mut z: u64) -> u64 {
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}
