//! SipHash-2-4 over whole words, for the hop tag. See Aumasson and Bernstein, "SipHash: a fast
//! short-input PRF". Implemented here because the verifier cannot follow loops over memory in the
//! eBPF program.

/// Returns SipHash-2-4 of `words` (little-endian, 8 bytes each) under a 128-bit key.
#[inline(always)]
pub fn siphash24<const N: usize>(key: [u64; 2], words: &[u64; N]) -> u64 {
    let mut v0 = key[0] ^ 0x736f_6d65_7073_6575;
    let mut v1 = key[1] ^ 0x646f_7261_6e64_6f6d;
    let mut v2 = key[0] ^ 0x6c79_6765_6e65_7261;
    let mut v3 = key[1] ^ 0x7465_6462_7974_6573;
    macro_rules! round {
        () => {
            v0 = v0.wrapping_add(v1);
            v1 = v1.rotate_left(13) ^ v0;
            v0 = v0.rotate_left(32);
            v2 = v2.wrapping_add(v3);
            v3 = v3.rotate_left(16) ^ v2;
            v0 = v0.wrapping_add(v3);
            v3 = v3.rotate_left(21) ^ v0;
            v2 = v2.wrapping_add(v1);
            v1 = v1.rotate_left(17) ^ v2;
            v2 = v2.rotate_left(32);
        };
    }
    let mut i = 0;
    while i < N {
        v3 ^= words[i];
        round!();
        round!();
        v0 ^= words[i];
        i += 1;
    }
    let length = ((N * 8) as u64) << 56;
    v3 ^= length;
    round!();
    round!();
    v0 ^= length;
    v2 ^= 0xff;
    round!();
    round!();
    round!();
    round!();
    v0 ^ v1 ^ v2 ^ v3
}

#[cfg(test)]
#[path = "../tests/unit/siphash.rs"]
mod tests;
