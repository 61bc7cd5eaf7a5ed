//! The replay window of a link. It records the accepted counts, so that the receiver accepts each
//! count at most once.
//!
//! The window is a ring of [`WORDS`] words. A word describes one *block* of 16 consecutive counts.
//! Its high 48 bits are the block number; each of the low 16 bits marks an accepted count. The
//! block 16 · [`WORDS`] counts later replaces it in the same word. The design follows RFC 6479
//! without its separate highest count: nothing is ever cleared, and a frame touches one word.
//!
//! **Concurrency.** A frame is accepted if and only if its own compare-exchange set its bit. The
//! block number of a word never decreases, and within a block bits are only set. No count is
//! therefore accepted twice, however many CPUs and planes share the window. A frame that loses
//! [`TRIES`] races in a row is refused although no other frame had its count. Each race is won by
//! another frame of the same word, and a block has 16 counts. Eight such frames must therefore
//! complete during eight compare-exchanges of this one.
//!
//! **Reordering.** A frame is never refused for being late while its distance to the highest
//! accepted count is less than [`TOLERANCE`]. From a distance of 16 · [`WORDS`] on, a frame is
//! always refused if the frames between have arrived.
//!
//! **Wrapping.** Frames carry the low 32 bits of their count. The receiver derives the high bits
//! from the window ([`whole`]) and includes them in the hop tag, like the extended sequence numbers
//! of RFC 4303. A link can therefore carry more than 2³² frames, and recorded frames do not
//! become fresh after the wrap. The count has 52 bits, which last 71 years at 2 million frames a
//! second.

#[cfg(target_has_atomic = "64")]
use core::sync::atomic::{AtomicU64, Ordering};

/// Words in a window.
pub const WORDS: usize = 256;

/// Number of later frames that may overtake a frame without its being refused.
pub const TOLERANCE: u64 = (WORDS as u64 - 1) * BLOCK;

/// Number of races that a frame may lose.
pub const TRIES: u32 = 8;

/// Counts in a block.
const BLOCK: u64 = 16;

/// The memory of a window, which other CPUs may change at any time. All zeros is an empty window.
///
/// An index is always below [`WORDS`]. Neither function orders any other memory access.
pub trait Words {
    fn load(&self, index: usize) -> u64;

    /// Stores `new` atomically if the word is `current`. Returns the previous word.
    fn compare_exchange(&self, index: usize, current: u64, new: u64) -> u64;
}

/// Returns the whole count of a frame with these low bits. The result is the count nearest to the
/// contents of the window. It is right as long as fewer than 2³¹ frames in a row are lost.
#[inline(always)]
pub fn whole(words: &impl Words, low: u32) -> u64 {
    let known = block(words.load(index(low.into()))) * BLOCK;
    let ahead = low.wrapping_sub(known as u32) as i32;
    let count = known.wrapping_add_signed(ahead.into());
    // No count precedes the first.
    if (count as i64) < 0 { low.into() } else { count }
}

/// Returns whether a frame of this count could be accepted now. Changes nothing.
#[inline(always)]
pub fn is_fresh(words: &impl Words, count: u64) -> bool {
    with(words.load(index(count)), count).is_some()
}

/// Records a count. Returns `false` if the count was already recorded, or is older than the window.
#[inline(always)]
pub fn take(words: &impl Words, count: u64) -> bool {
    let index = index(count);
    let mut word = words.load(index);
    let mut tries = 0;
    while tries < TRIES {
        let Some(new) = with(word, count) else { return false };
        let found = words.compare_exchange(index, word, new);
        if found == word {
            return true;
        }
        word = found;
        tries += 1;
    }
    false
}

/// Returns the value of `word` after recording `count`, or `None` if `count` is refused.
#[inline(always)]
fn with(word: u64, count: u64) -> Option<u64> {
    let (held, wanted) = (block(word), count / BLOCK);
    let bit = 1 << (count % BLOCK);
    if held < wanted {
        Some(wanted << BLOCK | bit)
    } else if held == wanted && word & bit == 0 {
        Some(word | bit)
    } else {
        None
    }
}

#[inline(always)]
fn block(word: u64) -> u64 {
    word >> BLOCK
}

#[inline(always)]
fn index(count: u64) -> usize {
    (count / BLOCK) as usize % WORDS
}

impl<W: Words + ?Sized> Words for &W {
    #[inline(always)]
    fn load(&self, index: usize) -> u64 {
        (**self).load(index)
    }

    #[inline(always)]
    fn compare_exchange(&self, index: usize, current: u64, new: u64) -> u64 {
        (**self).compare_exchange(index, current, new)
    }
}

/// A window in ordinary memory. (The compiler's description of the BPF target lacks
/// compare-exchange; `gdp-ebpf` provides its own.)
#[cfg(target_has_atomic = "64")]
pub type Window = [AtomicU64; WORDS];

/// Returns an empty window.
#[cfg(target_has_atomic = "64")]
pub const fn empty() -> Window {
    [const { AtomicU64::new(0) }; WORDS]
}

#[cfg(target_has_atomic = "64")]
impl Words for Window {
    #[inline(always)]
    fn load(&self, index: usize) -> u64 {
        self[index].load(Ordering::Relaxed)
    }

    #[inline(always)]
    fn compare_exchange(&self, index: usize, current: u64, new: u64) -> u64 {
        let result = self[index].compare_exchange(current, new, Ordering::Relaxed, Ordering::Relaxed);
        result.unwrap_or_else(|found| found)
    }
}

const _: () = {
    assert!(WORDS.is_power_of_two() && BLOCK.is_power_of_two());
    assert!(TOLERANCE >= 64);
};

#[cfg(test)]
#[path = "../tests/unit/replay.rs"]
mod tests;
