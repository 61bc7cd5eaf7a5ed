//! SipHash-2-4 in the lanes of vectors, for vectors of any width.

use gdp_wire::Header;

/// The constants that are mixed with a key (Aumasson and Bernstein, "SipHash", section 2.1).
pub const INITIAL: [u64; 4] =
    [0x736f_6d65_7073_6575, 0x646f_7261_6e64_6f6d, 0x6c79_6765_6e65_7261, 0x7465_6462_7974_6573];

/// The final word of the input: the number of bytes modulo 256 in its highest byte.
pub const LENGTH: u64 = ((Header::TAGGED_WORDS * 8) as u64) << 56;

/// Defines `make` for one kind of vector. The scope must contain `Vector` and its number of words,
/// `LANES`. For CPUs with the feature it must also contain `splat`, `add`, `xor`, `rotate` (left,
/// by a constant), `rotate_half` (by 32), `load`, `load_words` and `store`.
macro_rules! in_lanes {
    ($feature:literal) => {
        /// State of one hash in each lane.
        #[derive(Clone, Copy)]
        struct State([Vector; 4]);

        impl State {
            #[target_feature(enable = $feature)]
            #[inline]
            fn new([k0, k1]: [Vector; 2]) -> Self {
                let [c0, c1, c2, c3] = super::lanes::INITIAL;
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

        /// Computes `GROUPS * LANES` hashes of the entries from `first` on, in interleaved groups.
        /// While one group waits for its last result, another continues. Lanes after the last entry
        /// compute unused hashes.
        #[target_feature(enable = $feature)]
        #[inline]
        fn hash<const GROUPS: usize>(first: usize, of: &mut Tags, headers: &[Header]) {
            let mut states = [State([splat(0); 4]); GROUPS];
            let mut loaded = [[splat(0); Header::TAGGED_WORDS]; GROUPS];
            for group in 0..GROUPS {
                let lanes = first + group * LANES..first + (group + 1) * LANES;
                let mut frames = [&headers[0]; LANES];
                for (frame, position) in frames.iter_mut().zip(&of.positions[lanes.clone()]) {
                    *frame = &headers[(*position as usize).min(headers.len() - 1)];
                }
                states[group] = State::new([load(&of.keys[0][lanes.clone()]), load(&of.keys[1][lanes.clone()])]);
                loaded[group] = load_words(frames.map(|frame| zerocopy::transmute_ref!(frame)));
                loaded[group][1] = xor(loaded[group][1], load(&of.highs[lanes]));
            }
            for word in 0..Header::TAGGED_WORDS {
                let mut each = [splat(0); GROUPS];
                for group in 0..GROUPS {
                    each[group] = loaded[group][word];
                }
                absorb(&mut states, each);
            }
            absorb(&mut states, [splat(super::lanes::LENGTH); GROUPS]);
            for state in states.iter_mut() {
                state.0[2] = xor(state.0[2], splat(0xff));
            }
            for _ in 0..4 {
                for state in states.iter_mut() {
                    state.round();
                }
            }
            for (group, state) in states.into_iter().enumerate() {
                let [v0, v1, v2, v3] = state.0;
                let lanes = first + group * LANES..first + (group + 1) * LANES;
                store(xor(xor(v0, v1), xor(v2, v3)), &mut of.tags[lanes]);
            }
        }

        /// Computes the tags, as `Tags::make` does.
        #[target_feature(enable = $feature)]
        pub fn make(of: &mut Tags, headers: &[Header]) {
            const BOTH: usize = 2 * LANES;
            const { assert!(Tags::SIZE % BOTH == 0) };
            for first in (0..of.length).step_by(BOTH) {
                match of.length - first {
                    // A single tag is faster without vectors.
                    1 => of.make_one(first, headers),
                    2..=LANES => hash::<1>(first, of, headers),
                    _ => hash::<2>(first, of, headers),
                }
            }
        }
    };
}

pub(super) use in_lanes;
