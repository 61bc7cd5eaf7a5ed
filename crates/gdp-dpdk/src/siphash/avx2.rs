//! Four lanes, with AVX2.

use core::arch::x86_64::*;

use gdp_wire::Header;

use crate::siphash::tags::Tags;

const LANES: usize = 4;

type Vector = __m256i;

super::lanes::in_lanes!("avx2");

#[target_feature(enable = "avx2")]
#[inline]
fn splat(word: u64) -> Vector {
    _mm256_set1_epi64x(word as i64)
}

#[target_feature(enable = "avx2")]
#[inline]
fn add(a: Vector, b: Vector) -> Vector {
    _mm256_add_epi64(a, b)
}

#[target_feature(enable = "avx2")]
#[inline]
fn xor(a: Vector, b: Vector) -> Vector {
    _mm256_xor_si256(a, b)
}

#[target_feature(enable = "avx2")]
#[inline]
fn rotate<const BITS: i64>(a: Vector) -> Vector {
    let [left, right] = [_mm_cvtsi64_si128(BITS), _mm_cvtsi64_si128(64 - BITS)];
    _mm256_or_si256(_mm256_sll_epi64(a, left), _mm256_srl_epi64(a, right))
}

#[target_feature(enable = "avx2")]
#[inline]
fn rotate_half(a: Vector) -> Vector {
    _mm256_shuffle_epi32::<0b10_11_00_01>(a)
}

/// Loads from at least [`LANES`] words.
#[target_feature(enable = "avx2")]
#[inline]
fn load(words: &[u64]) -> Vector {
    let words = &words[..LANES];
    // SAFETY: 32 bytes are readable, with any alignment.
    unsafe { _mm256_loadu_si256(words.as_ptr().cast()) }
}

/// Stores to at least [`LANES`] words.
#[target_feature(enable = "avx2")]
#[inline]
fn store(a: Vector, words: &mut [u64]) {
    let words = &mut words[..LANES];
    // SAFETY: 32 bytes are writable, with any alignment.
    unsafe { _mm256_storeu_si256(words.as_mut_ptr().cast(), a) };
}

/// Returns a vector of the first tagged words of all headers, a vector of the second, and so on.
#[target_feature(enable = "avx2")]
#[inline]
fn load_words(headers: [&[u64; 12]; LANES]) -> [Vector; Header::TAGGED_WORDS] {
    let [w0, w1, _, w3] = columns::<0>(headers);
    let [w4, w5, w6, w7] = columns::<4>(headers);
    [w0, w1, w3, w4, w5, w6, w7]
}

/// Transposes four words of all headers, from `FROM` (0 … 8) on. Vector `i` contains word `FROM +
/// i` of each header.
#[target_feature(enable = "avx2")]
#[inline]
fn columns<const FROM: usize>(headers: [&[u64; 12]; LANES]) -> [Vector; 4] {
    let mut rows = [splat(0); LANES];
    for (row, header) in rows.iter_mut().zip(headers) {
        *row = load(&header[FROM..]);
    }
    let [a, b, c, d] = rows;
    // For each pair of rows: the words at positions 0 and 2, and at 1 and 3.
    let [ab02, ab13] = [_mm256_unpacklo_epi64(a, b), _mm256_unpackhi_epi64(a, b)];
    let [cd02, cd13] = [_mm256_unpacklo_epi64(c, d), _mm256_unpackhi_epi64(c, d)];
    [
        _mm256_permute2x128_si256::<0x20>(ab02, cd02),
        _mm256_permute2x128_si256::<0x20>(ab13, cd13),
        _mm256_permute2x128_si256::<0x31>(ab02, cd02),
        _mm256_permute2x128_si256::<0x31>(ab13, cd13),
    ]
}
