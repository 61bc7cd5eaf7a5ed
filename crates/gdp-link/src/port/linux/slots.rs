//! The buffers of a receive call, as slots that the kernel fills.

use crate::port::LinkAddr;
use crate::port::batch::{BufferSlot, RecvBatch};

impl RecvBatch {
    /// Creates `count` slots of `size` bytes, and removes all frames.
    pub(super) fn slots(&mut self, count: usize, size: usize) -> impl Iterator<Item = &mut [u8]> {
        self.clear();
        if self.storage.len() < count * size {
            // Not resized, because a resize would copy stale bytes. The kernel provides zeroed
            // pages only on first use.
            self.storage = vec![0; count * size];
        }
        self.storage.chunks_exact_mut(size).take(count)
    }

    /// Returns the bytes of slot `index`, with slots of `size` bytes.
    pub(super) fn slot(&self, index: usize, size: usize) -> &[u8] {
        &self.storage[index * size..][..size]
    }

    /// Adds the frame that begins at `at`, behind all earlier frames.
    pub(super) fn add(&mut self, at: usize, length: usize, from: LinkAddr, congested: bool) {
        debug_assert!(self.slots.last().is_none_or(|last| last.at + last.length <= at));
        self.slots.push(BufferSlot { at, length, from, congested });
    }
}
