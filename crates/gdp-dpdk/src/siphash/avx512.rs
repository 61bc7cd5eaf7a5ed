//! Eight lanes, with AVX-512F.

use core::arch::x86_64::*;

use gdp_wire::Header;

use crate::siphash::tags::Tags;

const LANES: usize = 8;

type Vector = __m512i;

super::lanes::in_lanes!("avx512f");

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

/// Loads from at least [`LANES`] words.
#[target_feature(enable = "avx512f")]
#[inline]
fn load(words: &[u64]) -> Vector {
    let words = &words[..LANES];
    // SAFETY: 64 bytes are readable, with any alignment.
    unsafe { _mm512_loadu_si512(words.as_ptr().cast()) }
}

/// Stores to at least [`LANES`] words.
#[target_feature(enable = "avx512f")]
#[inline]
fn store(a: Vector, words: &mut [u64]) {
    let words = &mut words[..LANES];
    // SAFETY: 64 bytes are writable, with any alignment.
    unsafe { _mm512_storeu_si512(words.as_mut_ptr().cast(), a) };
}

/// Returns a vector of the first tagged words of all headers, a vector of the second, and so on.
#[target_feature(enable = "avx512f")]
#[inline]
fn load_words(headers: [&[u64; 12]; LANES]) -> [Vector; Header::TAGGED_WORDS] {
    let mut rows = [splat(0); LANES];
    for (row, header) in rows.iter_mut().zip(headers) {
        *row = load(header);
    }
    let [w0, w1, _, w3, w4, w5, w6, w7] = transpose(rows);
    [w0, w1, w3, w4, w5, w6, w7]
}

/// Transposes the rows: row `i` of the result contains word `i` of each row.
#[target_feature(enable = "avx512f")]
#[inline]
fn transpose([a, b, c, d, e, f, g, h]: [Vector; 8]) -> [Vector; 8] {
    // For each pair of rows: the words at even positions (0, 2, 4, 6), and at odd positions.
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

/// Transposes pairs of words.
#[target_feature(enable = "avx512f")]
#[inline]
fn transpose_pairs([a, b, c, d]: [Vector; 4]) -> [Vector; 4] {
    // For each pair of rows: the pairs at positions 0 and 2, and at 1 and 3.
    let [ab02, ab13] = [_mm512_shuffle_i64x2::<0b10_00_10_00>(a, b), _mm512_shuffle_i64x2::<0b11_01_11_01>(a, b)];
    let [cd02, cd13] = [_mm512_shuffle_i64x2::<0b10_00_10_00>(c, d), _mm512_shuffle_i64x2::<0b11_01_11_01>(c, d)];
    [
        _mm512_shuffle_i64x2::<0b10_00_10_00>(ab02, cd02),
        _mm512_shuffle_i64x2::<0b10_00_10_00>(ab13, cd13),
        _mm512_shuffle_i64x2::<0b11_01_11_01>(ab02, cd02),
        _mm512_shuffle_i64x2::<0b11_01_11_01>(ab13, cd13),
    ]
}
