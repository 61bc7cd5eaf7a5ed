//! The replay window of a link: which counts its receiver has taken, so that it takes each once at
//! most.
//!
//! The window is a ring of [`WORDS`] words. A word speaks of one *block* of 16 consecutive counts:
//! the number of the block in the high 48 bits, and below it a bit for each count that was taken.
//! The next block of a word is the one 16 · [`WORDS`] counts on, and replaces it. After RFC 6479,
//! without its separate highest count: nothing is ever cleared, and a frame touches one word.
//!
//! **Concurrency.** A frame is taken if and only if its own compare-exchange set its bit. The
//! number of a word's block never falls, and within a block bits are only set: so no count is taken
//! twice, however many CPUs and planes share the window. The worst case is a frame that loses
//! [`TRIES`] races in a row: it is refused, though nobody took it. Each of these races was won by
//! another frame of the same word, and there are 16 to a block: others must get through eight of
//! them while this one does as many compare-exchanges.
//!
//! **Reordering.** A frame is never refused while it is behind the highest taken count by less than
//! [`TOLERANCE`], and always from 16 · [`WORDS`] on if the frames between arrived.
//!
//! **Wrapping.** Frames carry the low 32 bits of their count; the rest follows from the window
//! ([`whole`]) and goes into the hop tag, as the extended sequence numbers of RFC 4303 do. So a
//! link outlives 2³² frames, and what was recorded before is not fresh after. The count has 52
//! bits, which is 71 years at 2 million frames a second.

#[cfg(target_has_atomic = "64")]
use core::sync::atomic::{AtomicU64, Ordering};

/// Words in a window.
pub const WORDS: usize = 256;

/// Frames that may overtake another one without its being refused.
pub const TOLERANCE: u64 = (WORDS as u64 - 1) * BLOCK;

/// Races that a frame may lose.
pub const TRIES: u32 = 8;

/// Counts in a block.
const BLOCK: u64 = 16;

/// The memory of a window, which others may change at any moment. Zeros are a window that has taken
/// nothing.
///
/// An index is always below [`WORDS`]. Neither function orders any other memory access.
pub trait Words {
    fn load(&self, index: usize) -> u64;

    /// Stores `new` if the word is `current`, atomically; returns what it was.
    fn compare_exchange(&self, index: usize, current: u64, new: u64) -> u64;
}

/// The whole count that a frame with these low bits must have: the nearest to what the window has
/// seen, so it is right as long as fewer than 2³¹ frames in a row are lost.
#[inline(always)]
pub fn whole(words: &impl Words, low: u32) -> u64 {
    let known = block(words.load(index(low.into()))) * BLOCK;
    let ahead = low.wrapping_sub(known as u32) as i32;
    let count = known.wrapping_add_signed(ahead.into());
    // There is nothing before the first count.
    if (count as i64) < 0 { low.into() } else { count }
}

/// Whether a frame of this count could be taken now. Changes nothing.
#[inline(always)]
pub fn is_fresh(words: &impl Words, count: u64) -> bool {
    with(words.load(index(count)), count).is_some()
}

/// Takes a count; `false` if it was taken before, or is too old to say.
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

/// What `word` becomes when `count` is taken, if it may be.
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

/// A window in ordinary memory. (The compiler's description of the BPF target has no
/// compare-exchange; `gdp-ebpf` brings its own.)
#[cfg(target_has_atomic = "64")]
pub type Window = [AtomicU64; WORDS];

/// A window that has taken nothing.
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
