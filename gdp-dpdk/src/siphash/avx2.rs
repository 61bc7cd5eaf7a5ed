//! Four lanes, with AVX2.

use core::arch::x86_64::*;

const LANES: usize = 4;

type Vector = __m256i;

super::in_lanes!("avx2");

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

#[target_feature(enable = "avx2")]
#[inline]
fn load(words: &[u64; LANES]) -> Vector {
    // SAFETY: 32 bytes to read, of any alignment.
    unsafe { _mm256_loadu_si256(words.as_ptr().cast()) }
}

#[target_feature(enable = "avx2")]
#[inline]
fn store(a: Vector) -> [u64; LANES] {
    let mut words = [0; LANES];
    // SAFETY: 32 bytes to write, of any alignment.
    unsafe { _mm256_storeu_si256(words.as_mut_ptr().cast(), a) };
    words
}

/// The first words of all keys, and the second ones.
#[target_feature(enable = "avx2")]
#[inline]
fn load_keys([a, b, c, d]: [&[u64; 2]; LANES]) -> [Vector; 2] {
    let [ac, bd] = [load_both(a, c), load_both(b, d)];
    [_mm256_unpacklo_epi64(ac, bd), _mm256_unpackhi_epi64(ac, bd)]
}

#[target_feature(enable = "avx2")]
#[inline]
fn load_both(low: &[u64; 2], high: &[u64; 2]) -> Vector {
    // SAFETY: 16 bytes each to read, of any alignment.
    unsafe { _mm256_loadu2_m128i(high.as_ptr().cast(), low.as_ptr().cast()) }
}

/// The first words of all lanes, the second ones, and so on.
#[target_feature(enable = "avx2")]
#[inline]
fn load_words(words: [&[u64; 11]; LANES]) -> [Vector; 11] {
    let [w0, w1, w2, w3] = columns::<0>(words);
    let [w4, w5, w6, w7] = columns::<4>(words);
    let [_, w8, w9, w10] = columns::<7>(words);
    [w0, w1, w2, w3, w4, w5, w6, w7, w8, w9, w10]
}

/// The words from `FROM` (0 … 7) on of all lanes, transposed: row `i` is what were the words at place `i` of the rows.
#[target_feature(enable = "avx2")]
#[inline]
fn columns<const FROM: usize>(words: [&[u64; 11]; LANES]) -> [Vector; 4] {
    let mut rows = [splat(0); LANES];
    for (row, words) in rows.iter_mut().zip(words) {
        let (chunks, _) = words[FROM..].as_chunks();
        *row = load(&chunks[0]);
    }
    let [a, b, c, d] = rows;
    // Of two rows each: the words at places 0 and 2, and at 1 and 3.
    let [ab02, ab13] = [_mm256_unpacklo_epi64(a, b), _mm256_unpackhi_epi64(a, b)];
    let [cd02, cd13] = [_mm256_unpacklo_epi64(c, d), _mm256_unpackhi_epi64(c, d)];
    [
        _mm256_permute2x128_si256::<0x20>(ab02, cd02),
        _mm256_permute2x128_si256::<0x20>(ab13, cd13),
        _mm256_permute2x128_si256::<0x31>(ab02, cd02),
        _mm256_permute2x128_si256::<0x31>(ab13, cd13),
    ]
}
