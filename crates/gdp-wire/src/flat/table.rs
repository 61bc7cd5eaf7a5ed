//! The writer of a flat table. Only one writer exists at a time, so it reads its own memory without
//! synchronisation. Its stores are ordered for the readers in the parent module. The order also
//! allows a successor to adopt the table after a death between any two stores.
#![cfg(target_has_atomic = "64")]

use core::fmt;
use core::sync::atomic::{AtomicU64, Ordering, fence};

use super::{
    BUCKET, KEY, LINE, LINES, LIVE, MASK, Memory, PASSED, PATH, ProbeSequence, USED, Words, from_words, lookup,
    names_in, to_words,
};
use crate::fetch::fetch;
use crate::{FibEntry, Name};

/// Number of names whose first lines are fetched at once.
const BATCH: usize = 16;

/// Number of lines of its bucket that the name in this line passes.
const STEPS: Count = Count { shift: 2, max: LINES as u64 - 1 };

/// Number of names that start in this bucket and are in their second one. Only in the state of a
/// bucket's first line.
const SPILLED: Count = Count { shift: 5, max: (1 << 12) - 1 };

/// Number of moves of names that start in this line.
const MOVED: Count = Count { shift: 17, max: (1 << 15) - 1 };

/// The table has no room for the name: it is too small for its contents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// The memory does not contain a table of its size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotATable;

/// A table in memory shared with readers: `1 + 2ⁿ` buckets of [`BUCKET`] words, n > 0.
pub struct Table<M> {
    memory: M,
    key: [u64; 2],
    mask: u32,
    names: u32,
}

impl<M: AsRef<[AtomicU64]>> Table<M> {
    /// Creates an empty table in zeroed memory. `key` must be random and secret.
    pub fn begin(memory: M, key: [u64; 2]) -> Result<Self, NotATable> {
        let mask = mask_for(memory.as_ref())?;
        let header = memory.as_ref();
        header[KEY].store(key[0], Ordering::Relaxed);
        header[KEY + 1].store(key[1], Ordering::Relaxed);
        header[MASK].store(mask.into(), Ordering::Release);
        Ok(Self { memory, key, mask, names: 0 })
    }

    /// Takes over a table whose writer has died at any point. Readers may be active.
    pub fn adopt(memory: M) -> Result<Self, NotATable> {
        let mask = mask_for(memory.as_ref())?;
        let header = memory.as_ref();
        if header[MASK].load(Ordering::Acquire) != u64::from(mask) {
            return Err(NotATable);
        }
        let key = [KEY, KEY + 1].map(|word| header[word].load(Ordering::Relaxed));
        let mut table = Self { memory, key, mask, names: 0 };
        table.repair();
        Ok(table)
    }

    pub fn memory(&self) -> &M {
        &self.memory
    }

    /// Returns the number of names in the table.
    pub fn len(&self) -> u32 {
        self.names
    }

    pub fn is_empty(&self) -> bool {
        self.names == 0
    }

    /// Returns the number of names that the table is designed for. Further names may or may not
    /// fit.
    pub fn capacity(&self) -> u32 {
        names_in(self.mask + 2)
    }

    pub fn get(&self, name: &Name) -> Option<FibEntry> {
        lookup(&self.memory.as_ref(), name)
    }

    /// Returns all names, in no particular order.
    pub fn iter(&self) -> impl Iterator<Item = (Name, FibEntry)> {
        (BUCKET..self.words().len())
            .step_by(LINE)
            .filter(|at| self.is_live(*at))
            .map(|at| (self.name(at), self.entry(at)))
    }

    /// Adds a name, or changes its route. Concurrent lookups find the old or the new route.
    pub fn insert(&mut self, name: &Name, entry: FibEntry) -> Result<(), Full> {
        let probes = self.probes(name);
        let held = self.find(&probes, name);
        if held.is_some_and(|step| self.entry(probes.at(step)) == entry) {
            return Ok(());
        }
        let free = match self.free(&probes) {
            Some(free) => free,
            None => self.make_room(&probes)?,
        };
        self.put(&probes, free, name, entry)?;
        match held {
            Some(step) => self.take_back(&probes, step, Some(free)),
            None => self.names += 1,
        }
        Ok(())
    }

    /// Calls [`Self::insert`] for many routes, with overlapping cache misses. On an error, the
    /// routes before the one that did not fit are in the table.
    pub fn insert_all(&mut self, routes: &[(Name, FibEntry)]) -> Result<(), Full> {
        for batch in routes.chunks(BATCH) {
            self.fetch(batch.iter().map(|(name, _)| name));
            batch.iter().try_for_each(|(name, entry)| self.insert(name, *entry))?;
        }
        Ok(())
    }

    /// Loads the lines where the names are, or will be, into the caches, all at once.
    fn fetch<'n>(&self, names: impl Iterator<Item = &'n Name> + Clone) {
        let begins = |name| self.probes(name).at(0);
        let first = names.clone().fold(0, |all, name| all | self.state(begins(name)));
        let others = names.filter(|name| self.state(begins(*name)) & (LIVE | PASSED) != 0);
        let rest =
            others.fold(0, |all, name| (0..LINES).fold(all, |all, step| all | self.state(self.probes(name).at(step))));
        core::hint::black_box(first | rest);
    }

    /// Removes a name. Returns whether the name was in the table.
    pub fn remove(&mut self, name: &Name) -> bool {
        let probes = self.probes(name);
        let Some(step) = self.find(&probes, name) else { return false };
        self.take_back(&probes, step, None);
        self.names -= 1;
        true
    }

    /// Fills a free line of a name's path and makes it visible to readers.
    fn put(&mut self, probes: &ProbeSequence, free: usize, name: &Name, entry: FibEntry) -> Result<(), Full> {
        if free >= LINES {
            self.spill(probes, 1)?;
        }
        for at in (0..free).map(|step| probes.at(step)) {
            self.set_state(at, self.state(at) | PASSED);
        }
        let at = probes.at(free);
        // Readers of the previous contents must see the new use count before any word changes.
        let used = STEPS.put(self.state(at).wrapping_add(1 << USED), (free % LINES) as u64);
        self.words()[at].store(used, Ordering::Relaxed);
        fence(Ordering::Release);
        for (word, value) in self.words()[at + 1..at + LINE].iter().zip(name.words().iter().chain(&to_words(entry))) {
            word.store(*value, Ordering::Relaxed);
        }
        self.set_state(at, used | LIVE);
        Ok(())
    }

    /// Frees the line of a name at `step` of its path. The name is now at step `to`, or removed.
    fn take_back(&mut self, probes: &ProbeSequence, step: usize, to: Option<usize>) {
        if to.is_some() {
            let (at, begin) = (probes.at(0), self.state(probes.at(0)));
            self.set_state(at, MOVED.put(begin, MOVED.get(begin) + 1));
        }
        let at = probes.at(step);
        self.set_state(at, self.state(at) & !LIVE);
        if step >= LINES {
            // The name was counted, so this cannot overflow.
            let _ = self.spill(probes, -1);
            self.settle(probes.second);
        }
        // A name that moved further along still passes the lines it passed before.
        if to.unwrap_or(0) < step {
            self.settle(probes.first);
        }
    }

    /// Frees a line on a full path by moving its name along that name's own path. Returns the step
    /// that is now free.
    fn make_room(&mut self, probes: &ProbeSequence) -> Result<usize, Full> {
        for step in 0..PATH {
            let at = probes.at(step);
            let (name, entry) = (self.name(at), self.entry(at));
            let its = self.probes(&name);
            let Some(free) = self.free(&its) else { continue };
            let Some(from) = (0..PATH).find(|step| its.at(*step) == at) else { continue };
            if self.put(&its, free, &name, entry).is_ok() {
                self.take_back(&its, from, Some(free));
                return Ok(step);
            }
        }
        Err(Full)
    }

    /// Counts the names that start in the first bucket and are in the second.
    fn spill(&mut self, probes: &ProbeSequence, change: i64) -> Result<(), Full> {
        let at = probes.first as usize * BUCKET;
        let state = self.state(at);
        let spilled =
            SPILLED.get(state).checked_add_signed(change).filter(|count| *count <= SPILLED.max).ok_or(Full)?;
        self.set_state(at, SPILLED.put(state, spilled));
        Ok(())
    }

    /// Clears *passed* on the lines of a bucket that no name passes any more.
    fn settle(&mut self, bucket: u32) {
        let start = bucket as usize * BUCKET;
        if SPILLED.get(self.state(start)) > 0 {
            return;
        }
        // One bit per line avoids unpredictable branches.
        let (mut marked, mut passed) = (0u8, 0u8);
        for line in 0..LINES as u32 {
            let state = self.state(start + line as usize * LINE);
            let steps = (STEPS.get(state) * (state & LIVE)) as u32;
            marked |= u8::from(state & PASSED != 0) << line;
            passed |= ((1u8 << steps) - 1).rotate_left(line + LINES as u32 - steps);
        }
        let mut stale = marked & !passed;
        while stale != 0 {
            let at = start + stale.trailing_zeros() as usize * LINE;
            self.set_state(at, self.state(at) & !PASSED);
            stale &= stale - 1;
        }
    }

    /// Completes the last change of a writer that died. At any point of a change, marks and counts
    /// may be too high, but never too low. A name that was moving is in the table twice.
    fn repair(&mut self) {
        for bucket in 1..=self.mask + 1 {
            let at = bucket as usize * BUCKET;
            self.set_state(at, SPILLED.put(self.state(at), 0));
        }
        for at in (BUCKET..self.words().len()).step_by(LINE) {
            if !self.is_live(at) {
                continue;
            }
            let name = self.name(at);
            let probes = self.probes(&name);
            let found = self.find(&probes, &name);
            let counted = match found {
                Some(step) if probes.at(step) == at => step < LINES || self.spill(&probes, 1).is_ok(),
                // Readers find the other copy, or none.
                _ => false,
            };
            if counted {
                self.names += 1;
            } else {
                self.set_state(at, self.state(at) & !LIVE);
            }
        }
        (1..=self.mask + 1).for_each(|bucket| self.settle(bucket));
    }

    /// Returns the step of a name on its path.
    fn find(&self, probes: &ProbeSequence, name: &Name) -> Option<usize> {
        for step in 0..PATH {
            let at = probes.at(step);
            let state = self.state(at);
            if state & LIVE != 0 && self.name(at).is(name) {
                return Some(step);
            }
            if state & PASSED == 0 {
                return None;
            }
        }
        None
    }

    fn free(&self, probes: &ProbeSequence) -> Option<usize> {
        if !self.is_live(probes.at(0)) {
            return Some(0);
        }
        let mut step = 0;
        for bucket in [probes.first, probes.second] {
            let start = bucket as usize * BUCKET;
            let live =
                (0..LINES).fold(0u8, |live, line| live | ((self.state(start + line * LINE) & LIVE) as u8) << line);
            let taken = live.rotate_right(probes.slot as u32).trailing_ones() as usize;
            if taken < LINES {
                return Some(step + taken);
            }
            step += LINES;
        }
        None
    }

    fn probes(&self, name: &Name) -> ProbeSequence {
        ProbeSequence::of(name, self.key, self.mask)
    }

    fn is_live(&self, at: usize) -> bool {
        self.state(at) & LIVE != 0
    }

    fn name(&self, at: usize) -> Name {
        let words = [1, 2, 3, 4].map(|word| self.words()[at + word].load(Ordering::Relaxed));
        Name::from_words(words)
    }

    fn entry(&self, at: usize) -> FibEntry {
        from_words([5, 6, 7].map(|word| self.words()[at + word].load(Ordering::Relaxed)))
    }

    fn state(&self, at: usize) -> u64 {
        self.words()[at].load(Ordering::Relaxed)
    }

    /// Stores a state after all earlier writes.
    fn set_state(&self, at: usize, state: u64) {
        self.words()[at].store(state, Ordering::Release);
    }

    fn words(&self) -> &[AtomicU64] {
        self.memory.as_ref()
    }
}

/// Returns the number of names in a table that another writer may change. A name that moves
/// concurrently may count twice.
pub fn count(memory: &[AtomicU64]) -> usize {
    memory.iter().skip(BUCKET).step_by(LINE).filter(|state| state.load(Ordering::Relaxed) & LIVE != 0).count()
}

/// Prefetches the first two lines of a lookup without waiting: about every third name is in the
/// second.
#[inline]
pub fn prefetch(memory: &[AtomicU64], name: &Name) {
    let word = |index: usize| memory.get(index).map_or(0, |word| word.load(Ordering::Relaxed));
    let probes = ProbeSequence::of(name, [word(KEY), word(KEY + 1)], word(MASK) as u32);
    for step in 0..2 {
        if let Some(line) = memory.get(probes.at(step)) {
            fetch(line);
        }
    }
}

/// A number in some bits of a state.
struct Count {
    shift: u32,
    /// One less than a power of two.
    max: u64,
}

impl Count {
    fn get(&self, state: u64) -> u64 {
        (state >> self.shift) & self.max
    }

    /// Returns `state` with this count, which wraps.
    fn put(&self, state: u64, count: u64) -> u64 {
        (state & !(self.max << self.shift)) | ((count & self.max) << self.shift)
    }
}

const _: () = {
    assert!((STEPS.max + 1) << STEPS.shift == 1 << SPILLED.shift);
    assert!((SPILLED.max + 1) << SPILLED.shift == 1 << MOVED.shift);
    assert!((MOVED.max + 1) << MOVED.shift == 1 << USED);
};

impl ProbeSequence {
    /// Returns the index of the first word of the line at a step of the path.
    fn at(&self, step: usize) -> usize {
        let bucket = if step < LINES { self.first } else { self.second };
        bucket as usize * BUCKET + (self.slot + step) % LINES * LINE
    }
}

/// Valid while the writer's process maps the memory.
impl<'m> Memory for &'m [AtomicU64] {
    type Bucket = &'m [AtomicU64; BUCKET];

    #[inline]
    fn bucket(&self, index: u32) -> Option<Self::Bucket> {
        let (buckets, _) = self.as_chunks();
        buckets.get(index as usize)
    }
}

impl Words for &[AtomicU64; BUCKET] {
    #[inline]
    fn load(self, index: usize) -> u64 {
        self[index].load(Ordering::Relaxed)
    }

    #[inline]
    fn after(self, _loaded: u64) -> Self {
        fence(Ordering::Acquire);
        self
    }
}

impl fmt::Display for Full {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("there is no room for the name in the table")
    }
}

impl fmt::Display for NotATable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the memory does not hold a table of its size")
    }
}

impl core::error::Error for Full {}
impl core::error::Error for NotATable {}

fn mask_for(memory: &[AtomicU64]) -> Result<u32, NotATable> {
    let buckets = (memory.len() / BUCKET).checked_sub(1).ok_or(NotATable)?;
    let fits = memory.len().is_multiple_of(BUCKET) && buckets.is_power_of_two() && buckets > 1 && buckets < 1 << 29;
    if fits { Ok(buckets as u32 - 1) } else { Err(NotATable) }
}
