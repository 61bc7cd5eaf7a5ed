//! Hop tags of many frames at once: SipHash-2-4 in the lanes of vectors. What a tag is, `gdp_wire::siphash` says; here is the same
//! function for frames that came in one burst, whose tags do not depend on each other.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

use gdp_wire::siphash::siphash24;

/// The constants that a key is mixed with (Aumasson and Bernstein, "SipHash", section 2.1).
#[cfg(target_arch = "x86_64")]
const INITIAL: [u64; 4] = [0x736f_6d65_7073_6575, 0x646f_7261_6e64_6f6d, 0x6c79_6765_6e65_7261, 0x7465_6462_7974_6573];

/// The last word that is mixed in: how many bytes there are, modulo 256, in its highest byte.
#[cfg(target_arch = "x86_64")]
const LENGTH: u64 = (11 * 8) << 56;

/// SipHash-2-4 of each eleven words (little-endian, 8 bytes each) under the key at the same place. Should the slices differ in
/// length, which they must not, the shortest counts.
#[inline]
pub fn siphash24_many(keys: &[[u64; 2]], words: &[[u64; 11]], tags: &mut [u64]) {
    debug_assert!(keys.len() == words.len() && words.len() == tags.len(), "a key, words and a tag each");
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the CPU has the feature.
            return unsafe { avx512::siphash24_many(keys, words, tags) };
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has the feature.
            return unsafe { avx2::siphash24_many(keys, words, tags) };
        }
    }
    one_by_one(keys, words, tags);
}

/// As [`siphash24_many`], on any CPU.
#[inline]
fn one_by_one(keys: &[[u64; 2]], words: &[[u64; 11]], tags: &mut [u64]) {
    keys.iter().zip(words).zip(tags).for_each(|((key, words), tag)| *tag = siphash24(*key, words));
}

/// Defines `siphash24_many` for vectors of one kind. In scope: `Vector`; `LANES`, how many words it has; and, for CPUs with the
/// feature, `splat`, `add`, `xor`, `rotate` (to the left, by a constant), `rotate_half` (by 32), `load_keys`, `load_words` and `store`.
#[cfg(target_arch = "x86_64")]
macro_rules! in_lanes {
    ($feature:literal) => {
        /// The state of one hash in each lane.
        #[derive(Clone, Copy)]
        struct State([Vector; 4]);

        impl State {
            #[target_feature(enable = $feature)]
            #[inline]
            fn new([k0, k1]: [Vector; 2]) -> Self {
                let [c0, c1, c2, c3] = super::INITIAL;
                Self([xor(k0, splat(c0)), xor(k1, splat(c1)), xor(k0, splat(c2)), xor(k1, splat(c3))])
            }

            #[target_feature(enable = $feature)]
            #[inline]
            fn round(&mut self) {
                let [v0, v1, v2, v3] = &mut self.0;
                *v0 = add(*v0, *v1);
                *v2 = add(*v2, *v3);
                *v1 = xor(rotate::<13>(*v1), *v0);
                *v3 = xor(rotate::<16>(*v3), *v2);
                *v0 = rotate_half(*v0);
                *v0 = add(*v0, *v3);
                *v2 = add(*v2, *v1);
                *v3 = xor(rotate::<21>(*v3), *v0);
                *v1 = xor(rotate::<17>(*v1), *v2);
                *v2 = rotate_half(*v2);
            }
        }

        /// Mixes a word into each lane of each group.
        #[target_feature(enable = $feature)]
        #[inline]
        fn absorb<const GROUPS: usize>(states: &mut [State; GROUPS], words: [Vector; GROUPS]) {
            for i in 0..GROUPS {
                states[i].0[3] = xor(states[i].0[3], words[i]);
            }
            for _ in 0..2 {
                for state in states.iter_mut() {
                    state.round();
                }
            }
            for i in 0..GROUPS {
                states[i].0[0] = xor(states[i].0[0], words[i]);
            }
        }

        /// One to `GROUPS * LANES` hashes, or just as many if `FULL` says so, in interleaved groups: where one has to wait for what it
        /// last computed, another goes on. The lanes that nothing is left for do the last hash once more.
        #[target_feature(enable = $feature)]
        #[inline]
        fn hash<const GROUPS: usize, const FULL: bool>(keys: &[[u64; 2]], words: &[[u64; 11]], tags: &mut [u64]) {
            let last = if FULL { GROUPS * LANES } else { tags.len() } - 1;
            let (keys, words, tags) = (&keys[..=last], &words[..=last], &mut tags[..=last]);
            let mut states = [State([splat(0); 4]); GROUPS];
            let mut loaded = [[splat(0); 11]; GROUPS];
            for group in 0..GROUPS {
                let (mut group_keys, mut group_words) = ([&keys[0]; LANES], [&words[0]; LANES]);
                for lane in 0..LANES {
                    let i = (group * LANES + lane).min(last);
                    (group_keys[lane], group_words[lane]) = (&keys[i], &words[i]);
                }
                states[group] = State::new(load_keys(group_keys));
                loaded[group] = load_words(group_words);
            }
            for word in 0..11 {
                let mut each = [splat(0); GROUPS];
                for group in 0..GROUPS {
                    each[group] = loaded[group][word];
                }
                absorb(&mut states, each);
            }
            absorb(&mut states, [splat(super::LENGTH); GROUPS]);
            for state in states.iter_mut() {
                state.0[2] = xor(state.0[2], splat(0xff));
            }
            for _ in 0..4 {
                for state in states.iter_mut() {
                    state.round();
                }
            }
            for (state, tags) in states.into_iter().zip(tags.chunks_mut(LANES)) {
                let [v0, v1, v2, v3] = state.0;
                let all = store(xor(xor(v0, v1), xor(v2, v3)));
                tags.iter_mut().zip(all).for_each(|(tag, new)| *tag = new);
            }
        }

        /// As [`super::siphash24_many`].
        #[target_feature(enable = $feature)]
        pub fn siphash24_many(keys: &[[u64; 2]], words: &[[u64; 11]], tags: &mut [u64]) {
            const BOTH: usize = 2 * LANES;
            let bursts = keys.chunks(BOTH).zip(words.chunks(BOTH)).zip(tags.chunks_mut(BOTH));
            for ((keys, words), tags) in bursts {
                let count = keys.len().min(words.len()).min(tags.len());
                let (keys, words, tags) = (&keys[..count], &words[..count], &mut tags[..count]);
                match count {
                    // Sooner done without vectors.
                    1 => super::one_by_one(keys, words, tags),
                    LANES => hash::<1, true>(keys, words, tags),
                    BOTH => hash::<2, true>(keys, words, tags),
                    ..LANES => hash::<1, false>(keys, words, tags),
                    _ => hash::<2, false>(keys, words, tags),
                }
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
use in_lanes;

#[cfg(test)]
mod tests;
