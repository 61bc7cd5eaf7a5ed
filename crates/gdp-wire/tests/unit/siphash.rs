//! Unit tests of `siphash`.

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
        let reference = |words: &[u64]| {
            let mut reference = SipHasher24::new_with_keys(key[0], key[1]);
            words.iter().for_each(|w| reference.write(&w.to_le_bytes()));
            reference.finish()
        };
        assert_eq!(siphash24(key, &words), reference(&words));
        assert_eq!(siphash24(key, words.first_chunk::<7>().unwrap()), reference(&words[..7]));
    }
}
