//! Each path that the CPU has, against the function for one.

use gdp_wire::siphash::siphash24;

use super::*;

type Path = fn(&[[u64; 2]], &[[u64; 11]], &mut [u64]);

fn paths() -> Vec<(&'static str, Path)> {
    let mut paths: Vec<(_, Path)> = vec![("the best", siphash24_many), ("any CPU", one_by_one)];
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has the feature.
            paths.push(("AVX2", |keys, words, tags| unsafe { avx2::siphash24_many(keys, words, tags) }));
        }
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the CPU has the feature.
            paths.push(("AVX-512", |keys, words, tags| unsafe { avx512::siphash24_many(keys, words, tags) }));
        }
    }
    paths
}

/// SplitMix64.
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ *state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}

#[test]
fn agrees_with_the_function_for_one() {
    let mut state = 1;
    for (path, many) in paths() {
        for count in (0..=40).chain([63, 64, 65, 257]) {
            for _ in 0..50 {
                let keys: Vec<[u64; 2]> = (0..count).map(|_| [(); 2].map(|()| random(&mut state))).collect();
                let words: Vec<[u64; 11]> = (0..count).map(|_| [(); 11].map(|()| random(&mut state))).collect();
                let expected: Vec<u64> = keys.iter().zip(&words).map(|(key, words)| siphash24(*key, words)).collect();
                let mut tags = vec![0; count];
                many(&keys, &words, &mut tags);
                assert_eq!(tags, expected, "{path}, {count}");
            }
        }
    }
}

#[test]
fn each_word_counts_in_its_lane_alone() {
    const COUNT: usize = 27;
    for (path, many) in paths() {
        for lane in 0..COUNT {
            for place in 0..13 {
                let (mut keys, mut words) = ([[0; 2]; COUNT], [[0; 11]; COUNT]);
                match place {
                    0..11 => words[lane][place] = 1 << (place * 5),
                    _ => keys[lane][place - 11] = 1 << 63,
                }
                let mut tags = [0; COUNT];
                many(&keys, &words, &mut tags);
                for (i, tag) in tags.into_iter().enumerate() {
                    let is_same = tag == siphash24([0; 2], &[0; 11]);
                    assert_eq!(is_same, i != lane, "{path}: word {place} of lane {lane} in lane {i}");
                }
            }
        }
    }
}

#[test]
#[cfg(not(debug_assertions))]
fn the_shortest_slice_counts() {
    for (path, many) in paths() {
        let (keys, words) = (vec![[1; 2]; 21], vec![[2; 11]; 19]);
        let mut tags = [7; 30];
        many(&keys, &words, &mut tags);
        assert!(tags[..19].iter().all(|tag| *tag == siphash24([1; 2], &[2; 11])), "{path}");
        assert!(tags[19..].iter().all(|tag| *tag == 7), "{path}");
        many(&keys, &words, &mut tags[..3]);
        many(&keys[..0], &words, &mut tags);
        many(&keys[..2], &words, &mut tags[20..]);
        assert_eq!(tags[20..23], [siphash24([1; 2], &[2; 11]), siphash24([1; 2], &[2; 11]), 7], "{path}");
    }
}
