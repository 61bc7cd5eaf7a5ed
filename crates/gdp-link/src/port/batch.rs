//! Frames in numbers: where received ones lie, and what is to be sent. No system calls.

use super::LinkAddr;

/// Most frames one call receives on Ethernet, or sends. Also what a veth ring of 256 takes without
/// loss.
pub const BATCH: usize = 64;

/// Room for the frames one receive call takes, and what that call found.
pub struct RecvBatch {
    /// Slots of equal size, each for what the kernel hands over in one piece: a frame, or over UDP
    /// a run of them.
    storage: Vec<u8>,
    largest: usize,
    /// In the order in which they lie, without overlap.
    slots: Vec<BufferSlot>,
}

#[derive(Clone, Copy)]
struct BufferSlot {
    at: usize,
    length: usize,
    from: LinkAddr,
    congested: bool,
}

/// A frame as it arrived. It may lie at any address: copy the header out.
pub struct InFrame<'a> {
    pub bytes: &'a mut [u8],
    pub from: LinkAddr,
    /// A router between the two ends of the link marked it (CE, RFC 3168). Never on Ethernet.
    pub congested: bool,
}

impl RecvBatch {
    /// For frames of up to `largest` bytes; on Ethernet a larger one arrives cut, and shows as
    /// truncated.
    pub fn new(largest: usize) -> Self {
        Self { storage: Vec::new(), largest: largest.next_multiple_of(64), slots: Vec::with_capacity(BATCH) }
    }

    /// The frames of the last receive call.
    pub fn frames(&mut self) -> impl Iterator<Item = InFrame<'_>> {
        let (mut rest, mut taken) = (&mut self.storage[..], 0);
        self.slots.iter().map(move |slot| {
            let (frame, behind) = std::mem::take(&mut rest)[slot.at - taken..].split_at_mut(slot.length);
            (rest, taken) = (behind, slot.at + slot.length);
            InFrame { bytes: frame, from: slot.from, congested: slot.congested }
        })
    }

    /// Frame `index` of the last receive call, once more: to send what was rewritten in place.
    pub fn frame(&self, index: usize) -> &[u8] {
        let BufferSlot { at, length, .. } = self.slots[index];
        &self.storage[at..at + length]
    }

    /// The largest frame there is room for.
    pub fn largest(&self) -> usize {
        self.largest
    }

    pub fn len(&self) -> usize {
        self.slots.len()
    }

    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Takes a copy of a frame that came another way; `false` when [`BATCH`] frames are there.
    pub fn push(&mut self, frame: &[u8], from: LinkAddr, congested: bool) -> bool {
        if self.slots.len() >= BATCH {
            return false;
        }
        let at = self.slots.last().map_or(0, |last| last.at + last.length);
        let end = at + frame.len();
        if self.storage.len() < end {
            self.storage.resize(end, 0);
        }
        self.storage[at..end].copy_from_slice(frame);
        self.slots.push(BufferSlot { at, length: frame.len(), from, congested });
        true
    }

    pub(super) fn clear(&mut self) {
        self.slots.clear();
    }

    /// Makes `count` slots of `size` bytes, and forgets the frames there were.
    pub(super) fn slots(&mut self, count: usize, size: usize) -> impl Iterator<Item = &mut [u8]> {
        self.clear();
        if self.storage.len() < count * size {
            // Not resized: that would copy what nobody needs. Zeros are not written before a page
            // is used.
            self.storage = vec![0; count * size];
        }
        self.storage.chunks_exact_mut(size).take(count)
    }

    /// The bytes of slot `index` of those with `size` bytes.
    pub(super) fn slot(&self, index: usize, size: usize) -> &[u8] {
        &self.storage[index * size..][..size]
    }

    /// Says that a frame begins at `at`, behind those added before.
    pub(super) fn add(&mut self, at: usize, length: usize, from: LinkAddr, congested: bool) {
        debug_assert!(self.slots.last().is_none_or(|last| last.at + last.length <= at));
        self.slots.push(BufferSlot { at, length, from, congested });
    }
}

/// A frame to send, in two pieces that need not lie together.
#[derive(Clone, Copy)]
pub struct OutFrame<'a> {
    pub to: LinkAddr,
    /// At least the two bytes that say what the frame is and its traffic class.
    pub head: &'a [u8],
    /// May be empty.
    pub body: &'a [u8],
}

/// What became of frames that were to be sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sent {
    /// Handed to the kernel.
    pub sent: usize,
    /// Given up: no room in time, an interface that is down, an address of another kind of port.
    pub lost: usize,
}
