//! Eight lanes, with AVX-512F.

use core::arch::x86_64::*;

const LANES: usize = 8;

type Vector = __m512i;

super::in_lanes!("avx512f");

#[target_feature(enable = "avx512f")]
#[inline]
fn splat(word: u64) -> Vector {
    _mm512_set1_epi64(word as i64)
}

#[target_feature(enable = "avx512f")]
#[inline]
fn add(a: Vector, b: Vector) -> Vector {
    _mm512_add_epi64(a, b)
}

#[target_feature(enable = "avx512f")]
#[inline]
fn xor(a: Vector, b: Vector) -> Vector {
    _mm512_xor_si512(a, b)
}

#[target_feature(enable = "avx512f")]
#[inline]
fn rotate<const BITS: i32>(a: Vector) -> Vector {
    _mm512_rol_epi64::<BITS>(a)
}

#[target_feature(enable = "avx512f")]
#[inline]
fn rotate_half(a: Vector) -> Vector {
    rotate::<32>(a)
}

#[target_feature(enable = "avx512f")]
#[inline]
fn load(words: &[u64; LANES]) -> Vector {
    // SAFETY: 64 bytes to read, of any alignment.
    unsafe { _mm512_loadu_si512(words.as_ptr().cast()) }
}

#[target_feature(enable = "avx512f")]
#[inline]
fn store(a: Vector) -> [u64; LANES] {
    let mut words = [0; LANES];
    // SAFETY: 64 bytes to write, of any alignment.
    unsafe { _mm512_storeu_si512(words.as_mut_ptr().cast(), a) };
    words
}

/// The first words of all keys, and the second ones.
#[target_feature(enable = "avx512f")]
#[inline]
fn load_keys([a, b, c, d, e, f, g, h]: [&[u64; 2]; LANES]) -> [Vector; 2] {
    let [aceg, bdfh] = [load_four(a, c, e, g), load_four(b, d, f, h)];
    [_mm512_unpacklo_epi64(aceg, bdfh), _mm512_unpackhi_epi64(aceg, bdfh)]
}

#[target_feature(enable = "avx512f")]
#[inline]
fn load_four(a: &[u64; 2], b: &[u64; 2], c: &[u64; 2], d: &[u64; 2]) -> Vector {
    let ab = _mm512_inserti32x4::<1>(_mm512_castsi128_si512(load_key(a)), load_key(b));
    _mm512_inserti32x4::<3>(_mm512_inserti32x4::<2>(ab, load_key(c)), load_key(d))
}

#[target_feature(enable = "avx512f")]
#[inline]
fn load_key(key: &[u64; 2]) -> __m128i {
    // SAFETY: 16 bytes to read, of any alignment.
    unsafe { _mm_loadu_si128(key.as_ptr().cast()) }
}

/// The first words of all lanes, the second ones, and so on.
#[target_feature(enable = "avx512f")]
#[inline]
fn load_words(words: [&[u64; 11]; LANES]) -> [Vector; 11] {
    let [w0, w1, w2, w3, w4, w5, w6, w7] = columns::<0>(words);
    let [.., w8, w9, w10] = columns::<3>(words);
    [w0, w1, w2, w3, w4, w5, w6, w7, w8, w9, w10]
}

/// The words from `FROM` (0 … 3) on of all lanes, transposed.
#[target_feature(enable = "avx512f")]
#[inline]
fn columns<const FROM: usize>(words: [&[u64; 11]; LANES]) -> [Vector; 8] {
    let mut rows = [splat(0); LANES];
    for (row, words) in rows.iter_mut().zip(words) {
        let (chunks, _) = words[FROM..].as_chunks();
        *row = load(&chunks[0]);
    }
    transpose(rows)
}

/// Makes row `i` of what were the words at place `i` of the rows.
#[target_feature(enable = "avx512f")]
#[inline]
fn transpose([a, b, c, d, e, f, g, h]: [Vector; 8]) -> [Vector; 8] {
    // Of two rows each: the words at even places (0, 2, 4, 6), and at odd ones.
    let even = [
        _mm512_unpacklo_epi64(a, b),
        _mm512_unpacklo_epi64(c, d),
        _mm512_unpacklo_epi64(e, f),
        _mm512_unpacklo_epi64(g, h),
    ];
    let odd = [
        _mm512_unpackhi_epi64(a, b),
        _mm512_unpackhi_epi64(c, d),
        _mm512_unpackhi_epi64(e, f),
        _mm512_unpackhi_epi64(g, h),
    ];
    let [[r0, r2, r4, r6], [r1, r3, r5, r7]] = [transpose_pairs(even), transpose_pairs(odd)];
    [r0, r1, r2, r3, r4, r5, r6, r7]
}

/// The same with pairs of words.
#[target_feature(enable = "avx512f")]
#[inline]
fn transpose_pairs([a, b, c, d]: [Vector; 4]) -> [Vector; 4] {
    // Of two rows each: the pairs at places 0 and 2, and at 1 and 3.
    let [ab02, ab13] = [_mm512_shuffle_i64x2::<0b10_00_10_00>(a, b), _mm512_shuffle_i64x2::<0b11_01_11_01>(a, b)];
    let [cd02, cd13] = [_mm512_shuffle_i64x2::<0b10_00_10_00>(c, d), _mm512_shuffle_i64x2::<0b11_01_11_01>(c, d)];
    [
        _mm512_shuffle_i64x2::<0b10_00_10_00>(ab02, cd02),
        _mm512_shuffle_i64x2::<0b10_00_10_00>(ab13, cd13),
        _mm512_shuffle_i64x2::<0b11_01_11_01>(ab02, cd02),
        _mm512_shuffle_i64x2::<0b11_01_11_01>(ab13, cd13),
    ]
}
