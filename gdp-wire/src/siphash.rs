//! SipHash-2-4 over whole words: the hop tag. Aumasson and Bernstein, "SipHash: a fast short-input PRF".
//! Written out here because the eBPF program needs it without loops over memory the verifier cannot follow.

/// SipHash-2-4 of `words` (little-endian, 8 bytes each) under a 128-bit key.
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
mod tests {
    use super::*;
    use siphasher::sip::SipHasher24;
    use std::hash::Hasher;

    #[test]
    fn agrees_with_the_reference_implementation() {
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            state ^ state >> 29
        };
        for _ in 0..1000 {
            let key = [next(), next()];
            let words: [u64; 11] = core::array::from_fn(|_| next());
            let mut reference = SipHasher24::new_with_keys(key[0], key[1]);
            words.iter().for_each(|w| reference.write(&w.to_le_bytes()));
            assert_eq!(siphash24(key, &words), reference.finish());
        }
    }
}
