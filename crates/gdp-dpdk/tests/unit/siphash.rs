//! Compares each vector path that the CPU supports with the function for a single tag.

use zerocopy::IntoBytes;

use super::*;

type Path = fn(&mut Tags, &[Header]);

fn paths() -> Vec<(&'static str, Path)> {
    let mut paths: Vec<(_, Path)> = vec![("the best", Tags::make), ("any CPU", Tags::make_each)];
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has the feature.
            paths.push(("AVX2", |tags, headers| unsafe { avx2::make(tags, headers) }));
        }
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the CPU has the feature.
            paths.push(("AVX-512", |tags, headers| unsafe { avx512::make(tags, headers) }));
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
    let mut tags = Tags::new();
    for (path, make) in paths() {
        for count in 0..=Tags::SIZE {
            for _ in 0..20 {
                let mut headers = vec![Header::default(); count * 2];
                headers.iter_mut().for_each(|header| header.as_mut_bytes().fill_with(|| random(&mut state) as u8));
                tags.clear();
                let mut expected = Vec::new();
                for _ in 0..count {
                    let place = random(&mut state) as usize % headers.len();
                    let (key, number) = ([(); 2].map(|()| random(&mut state)), random(&mut state) >> 12);
                    tags.add(place as u32, key, number);
                    expected.push(headers[place].tag_for(key, number));
                }
                make(&mut tags, &headers);
                assert_eq!(tags.tags(), expected, "{path}, {count}");
            }
        }
    }
}

#[test]
fn what_changes_in_one_lane_counts_there_alone() {
    const COUNT: usize = 27;
    for (path, make) in paths() {
        for lane in 0..COUNT {
            for byte in 0..Header::LEN + 3 {
                let (mut headers, mut keys, mut counts) = ([Header::default(); COUNT], [[0; 2]; COUNT], [0; COUNT]);
                match byte.checked_sub(Header::LEN) {
                    None => headers[lane].as_mut_bytes()[byte] = 1 << (byte % 8),
                    Some(half @ ..2) => keys[lane][half] = 1 << 63,
                    Some(_) => counts[lane] = 1 << 40,
                }
                let is_source = (64..Header::LEN).contains(&byte);
                let mut tags = Tags::new();
                (0..COUNT).for_each(|i| tags.add(i as u32, keys[i], counts[i]));
                make(&mut tags, &headers);
                for (i, tag) in tags.tags().iter().enumerate() {
                    let is_same = *tag == Header::default().tag_for([0; 2], 0);
                    assert_eq!(
                        is_same,
                        i != lane || Header::TAG.contains(&byte) || is_source,
                        "{path}: byte {byte} of lane {lane} in lane {i}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_tag_is_given_out_only_for_what_it_was_made_from() {
    let mut tags = Tags::new();
    tags.add(0, [1, 2], 3);
    tags.make(&[Header::default()]);
    assert_eq!(tags.made_from(0, [1, 2], 3), Some(Header::default().tag_for([1, 2], 3)));
    for (key, count) in [([0, 2], 3), ([1, 0], 3), ([1, 2], 4)] {
        assert_eq!(tags.made_from(0, key, count), None);
    }
}
