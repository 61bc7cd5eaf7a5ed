//! The FIB as a flat table. A lookup costs one cache miss, also while a writer changes the table.
//!
//! ```text
//!  word of a bucket   0       1 … 4   5 … 7   8 …
//!  header             mask    key 0, key 1
//!  bucket 1 … n       state   name    entry   state … (8 lines of one cache line each)
//! ```
//!
//! A hash of the name selects two buckets and a start line. The name is in the first free line from
//! the start line on, around the first bucket and then around the second. [`lookup`] is the reader,
//! for the kernel and for user space. [`Table`] is the only writer, in user space on the same
//! memory. In a full table of size [`buckets_for`], half of the lines are free: 128 B per name.
//!
//! **A line is written once.** Its *state* contains three things: whether the line is live, whether
//! names that start before it may be behind it (*passed*), and its use count. The contents of a
//! live line do not change. To change a route, the writer fills another line and then frees the old
//! one. A reader accepts an entry only if the use count of the line is the same before and after
//! the read. The words read between belong to one route of this name, which was valid during the
//! lookup.
//!
//! **A changing route is never missed.** When a name moves to another line, the state of its start
//! line changes before the old line is freed. A reader that finds nothing checks that state again,
//! and repeats the lookup if the state has changed. After [`TRIES`] attempts the reader finds
//! nothing. For this, the name or its neighbours must change within nanoseconds each time.
//!
//! **A removal leaves no gaps.** A search ends at a line that no name has passed, not at a free
//! line. The writer clears *passed* when no name needs it any more. A search for a missing name
//! therefore usually ends at its start line.
//!
//! **The hash has a secret key.** An owner of many names cannot choose names that share a bucket,
//! because every table distributes them differently. One word of a name suffices for the hash. Two
//! buckets have 16 lines, and 17 names that agree in 64 bits cost some 2⁶⁰ hashes to find.

mod table;

use crate::{FibEntry, Name};

#[cfg(target_has_atomic = "64")]
pub use table::{Full, NotATable, Table, count, prefetch};

/// Lines in a bucket.
const LINES: usize = 8;

/// Words in a line.
const LINE: usize = 8;

/// Words in a bucket, which is an element of a BPF array.
pub const BUCKET: usize = LINES * LINE;

/// Maximum number of lookups of a reader for a name that moves.
pub const TRIES: u32 = 4;

/// Number of lines that a name may be in.
const PATH: usize = 2 * LINES;

/// Words of the header, which is the first bucket of the memory.
const MASK: usize = 0;
const KEY: usize = 1;

/// Parts of a state. The high 32 bits are the use count of the line. The bits between contain
/// counts of the writer.
const LIVE: u64 = 1;
const PASSED: u64 = 2;
const USED: u32 = 32;

/// The words of a bucket, which a writer may change at any time.
pub trait Words: Copy {
    /// Returns the word at `index`, below [`BUCKET`].
    fn load(self, index: usize) -> u64;

    /// Returns the same words, for loads that happen after `loaded` was loaded.
    fn after(self, loaded: u64) -> Self;
}

/// The memory of a table, as seen by readers.
pub trait Memory {
    type Bucket: Words;

    /// Returns a bucket. Bucket 0 is the header.
    fn bucket(&self, index: u32) -> Option<Self::Bucket>;
}

/// Returns the number of buckets of a table for `names` names, including the header.
pub const fn buckets_for(names: u32) -> u32 {
    let buckets = (names as usize * 2).div_ceil(LINES).next_power_of_two();
    1 + if buckets < 2 { 2 } else { buckets as u32 }
}

/// Returns the number of names that a table of `buckets` buckets, including the header, is designed
/// for.
pub const fn names_in(buckets: u32) -> u32 {
    (buckets - 1) * (LINES / 2) as u32
}

/// Returns the route of a name.
#[inline(always)]
pub fn lookup(table: &impl Memory, name: &Name) -> Option<FibEntry> {
    let header = table.bucket(0)?;
    let probes = ProbeSequence::of(name, [header.load(KEY), header.load(KEY + 1)], header.load(MASK) as u32);
    let first = table.bucket(probes.first)?;
    let mut tries = 0;
    while tries < TRIES {
        let begin = first.load(probes.slot * LINE);
        let mut words = first.after(begin);
        // Combines all loaded words, so that later loads can be made to depend on them.
        let mut seen = 0;
        let mut step = 0;
        while step < PATH {
            if step == LINES {
                words = table.bucket(probes.second)?.after(begin);
            }
            let line = (probes.slot + step) % LINES * LINE;
            let state = if step == 0 { begin } else { words.load(line) };
            let content = words.after(state);
            seen |= state;
            if state & LIVE != 0 {
                let other = difference(content, line, name);
                seen |= other;
                if other == 0 {
                    let entry = [content.load(line + 5), content.load(line + 6), content.load(line + 7)];
                    let again = content.after(entry[0] | entry[1] | entry[2] | other).load(line);
                    if again >> USED == state >> USED {
                        return Some(from_words(entry));
                    }
                    seen |= again;
                }
            }
            if state & PASSED == 0 {
                break;
            }
            step += 1;
        }
        if first.after(seen).load(probes.slot * LINE) == begin {
            return None;
        }
        tries += 1;
    }
    None
}

/// Returns zero if the name in a line is `name`.
#[inline(always)]
fn difference(words: impl Words, line: usize, name: &Name) -> u64 {
    let [a, b, c, d] = *name.words();
    (words.load(line + 1) ^ a) | (words.load(line + 2) ^ b) | (words.load(line + 3) ^ c) | (words.load(line + 4) ^ d)
}

/// The lines of a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ProbeSequence {
    first: u32,
    second: u32,
    /// The start line, in both buckets.
    slot: usize,
}

impl ProbeSequence {
    /// `mask` is one less than the number of buckets, which is a power of two and not 1.
    #[inline(always)]
    fn of(name: &Name, key: [u64; 2], mask: u32) -> Self {
        let factor = key[1] | 1;
        let mut hash = (name.words()[0] ^ key[0]).wrapping_mul(factor);
        hash ^= hash >> 32;
        hash = hash.wrapping_mul(factor);
        hash ^= hash >> 29;
        let first = (hash >> 32) as u32 & mask;
        let second = first ^ ((hash >> 3) as u32 | 1) & mask;
        Self { first: 1 + first, second: 1 + second, slot: hash as usize % LINES }
    }
}

/// Returns the entry with these words.
#[inline(always)]
pub const fn from_words(words: [u64; 3]) -> FibEntry {
    // SAFETY: an entry is 24 bytes of plain integers (`table` asserts the size), for which any
    // bytes are valid.
    unsafe { core::mem::transmute::<[u64; 3], FibEntry>(words) }
}

/// Returns the words of an entry as in memory, which is the format of the table.
#[inline(always)]
pub const fn to_words(entry: FibEntry) -> [u64; 3] {
    // SAFETY: as above; without padding.
    unsafe { core::mem::transmute::<FibEntry, [u64; 3]>(entry) }
}

const _: () = {
    assert!(size_of::<FibEntry>() == 24 && size_of::<Name>() == 32);
    assert!(LINE * size_of::<u64>() == 64);
};
