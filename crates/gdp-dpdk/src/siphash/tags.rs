//! A batch of tags to compute, and the results.

use crate::Burst;
use gdp_wire::Header;

/// Inputs of at most [`Self::SIZE`] tags, and the tags. They are stored in columns, which lanes
/// load directly. The words of the headers are not copied.
pub struct Tags {
    pub length: usize,
    pub keys: [[u64; Self::SIZE]; 2],
    pub counts: [u64; Self::SIZE],
    /// The bits that the high 32 bits of the count change in the word with the link.
    pub highs: [u64; Self::SIZE],
    /// Indices of the headers.
    pub positions: [u32; Self::SIZE],
    pub tags: [u64; Self::SIZE],
}

impl Tags {
    /// Maximum number of tags.
    pub const SIZE: usize = Burst::SIZE;

    pub const fn new() -> Self {
        let nothing = [0; Self::SIZE];
        let positions = [0; Self::SIZE];
        Self { length: 0, keys: [nothing; 2], counts: nothing, highs: nothing, positions, tags: nothing }
    }

    pub fn clear(&mut self) {
        self.length = 0;
    }

    /// Adds the header at index `position`, for frame `count` of a link with this key. The
    /// batch must not be full.
    #[inline]
    pub fn add(&mut self, position: u32, key: [u64; 2], count: u64) {
        let i = self.length;
        (self.keys[0][i], self.keys[1][i]) = (key[0], key[1]);
        (self.counts[i], self.highs[i]) = (count, ((count >> 32) as u32).swap_bytes().into());
        self.positions[i] = position;
        self.length += 1;
    }

    /// Returns the computed tags, in the order in which they were added.
    #[inline]
    pub fn tags(&self) -> &[u64] {
        &self.tags[..self.length]
    }

    /// Returns the tag of entry `i`, if it was computed from this key and count.
    #[inline]
    pub fn made_from(&self, i: usize, key: [u64; 2], count: u64) -> Option<u64> {
        let same = self.keys[0][i] == key[0] && self.keys[1][i] == key[1] && self.counts[i] == count;
        same.then_some(self.tags[i])
    }

    /// Computes the tags as [`Self::make`] does, on any CPU.
    pub fn make_each(&mut self, headers: &[Header]) {
        (0..self.length).for_each(|i| self.make_one(i, headers));
    }

    #[inline]
    pub fn make_one(&mut self, i: usize, headers: &[Header]) {
        let key = [self.keys[0][i], self.keys[1][i]];
        self.tags[i] = headers[self.positions[i] as usize].tag_for(key, self.counts[i]);
    }
}

impl Default for Tags {
    fn default() -> Self {
        Self::new()
    }
}
