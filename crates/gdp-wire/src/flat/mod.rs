//! The FIB as a flat table: where a name leads, found with one cache miss while a writer changes
//! the table.
//!
//! ```text
//!  word of a bucket   0       1 … 4   5 … 7   8 …
//!  header             mask    key 0, key 1
//!  bucket 1 … n       state   name    entry   state … (8 lines of one cache line each)
//! ```
//!
//! A name has two buckets and a line to begin with, from a hash of it. It is in the first free line
//! from there on, around the first bucket and then around the second. [`lookup`] is the reader, for
//! the kernel as well as for user space; [`Table`] is the only writer, in user space, on the same
//! memory. Sized by [`buckets_for`], half of the lines are free: 128 B a name when the table is
//! full.
//!
//! **A line is written once.** Its *state* says whether it is live, whether names that begin before
//! it may lie behind it (*passed*), and how often the line was used. What is in a live line does
//! not change: to change a route, the writer fills another line and then takes the old one back. A
//! reader takes an entry only if the line's number of uses is the same before and after: the words
//! between are those of one route of this name, which held during the lookup.
//!
//! **A route that changes is never missed.** When a name moves to another line, the state of the
//! line it begins with changes before the old line goes. A reader that finds nothing looks at that
//! state again; if it changed, the reader looks again. A reader that does so [`TRIES`] times in
//! vain finds nothing: the same name, or its neighbours, must change each time within nanoseconds.
//!
//! **A removal leaves no gaps**, because what ends a search is a line that nobody passed, not a
//! free one; the writer takes a *passed* back once nobody needs it. So a search for a name that is
//! not there ends at its first line as a rule.
//!
//! **The hash is keyed**, by a number that nobody outside learns: an owner of many names cannot
//! pick such that share a bucket, because which do is another matter in every table. One word of a
//! name is enough: to find 17 names that agree in 64 bits, one more than two buckets hold, is some
//! 2⁶⁰ hashes of work.

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

/// How often a reader looks for a name that moves.
pub const TRIES: u32 = 4;

/// Lines a name may be in.
const PATH: usize = 2 * LINES;

/// Words of the header: the first bucket of the memory.
const MASK: usize = 0;
const KEY: usize = 1;

/// Parts of a state. In the high 32 bits it counts how often the line was used; the writer keeps
/// counts of its own between.
const LIVE: u64 = 1;
const PASSED: u64 = 2;
const USED: u32 = 32;

/// The words of a bucket, which a writer may change at any moment.
pub trait Words: Copy {
    /// The word at `index`, below [`BUCKET`].
    fn load(self, index: usize) -> u64;

    /// The same words, as they are after `loaded` was.
    fn after(self, loaded: u64) -> Self;
}

/// The memory of a table, as its readers see it.
pub trait Memory {
    type Bucket: Words;

    /// Bucket 0 is the header.
    fn bucket(&self, index: u32) -> Option<Self::Bucket>;
}

/// Buckets, the header included, of a table for so many names.
pub const fn buckets_for(names: u32) -> u32 {
    let buckets = (names as usize * 2).div_ceil(LINES).next_power_of_two();
    1 + if buckets < 2 { 2 } else { buckets as u32 }
}

/// Names that a table of so many buckets, the header included, is meant for.
pub const fn names_in(buckets: u32) -> u32 {
    (buckets - 1) * (LINES / 2) as u32
}

/// Where a name leads.
#[inline(always)]
pub fn lookup(table: &impl Memory, name: &Name) -> Option<FibEntry> {
    let header = table.bucket(0)?;
    let probes = ProbeSequence::of(name, [header.load(KEY), header.load(KEY + 1)], header.load(MASK) as u32);
    let first = table.bucket(probes.first)?;
    let mut tries = 0;
    while tries < TRIES {
        let begin = first.load(probes.slot * LINE);
        let mut words = first.after(begin);
        // Of everything that was loaded, so that what comes after can be made to do so.
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

/// Zero if the name in a line is this one.
#[inline(always)]
fn difference(words: impl Words, line: usize, name: &Name) -> u64 {
    let [a, b, c, d] = *name.words();
    (words.load(line + 1) ^ a) | (words.load(line + 2) ^ b) | (words.load(line + 3) ^ c) | (words.load(line + 4) ^ d)
}

/// Where the lookup of a name probes: two buckets, and the line at which it begins in both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ProbeSequence {
    first: u32,
    second: u32,
    /// First line in both buckets.
    slot: usize,
}

impl ProbeSequence {
    /// `mask`: one less than the number of buckets, which is a power of two and not 1.
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

/// The entry of which these are the words.
#[inline(always)]
pub const fn from_words(words: [u64; 3]) -> FibEntry {
    // SAFETY: an entry is 24 bytes of plain integers (`table` asserts the size), any of which are
    // one.
    unsafe { core::mem::transmute::<[u64; 3], FibEntry>(words) }
}

/// The words of an entry, as they lie in memory: what a table holds.
#[inline(always)]
pub const fn to_words(entry: FibEntry) -> [u64; 3] {
    // SAFETY: as above; without padding.
    unsafe { core::mem::transmute::<FibEntry, [u64; 3]>(entry) }
}

const _: () = {
    assert!(size_of::<FibEntry>() == 24 && size_of::<Name>() == 32);
    assert!(LINE * size_of::<u64>() == 64);
};
