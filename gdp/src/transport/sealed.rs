//! A sealed message as the transport sees it: frame payloads, and which segments each of them carries.

use crate::seal::{Segments, segment_ids};

/// The place of a segment in its session. A message's proof is behind its last body segment, so places are in the order of sending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    pub sequence: u64,
    pub index: u32,
}

/// A message, or several under one signature, cut into frame payloads.
#[derive(Debug)]
pub struct Sealed {
    bytes: Vec<u8>,
    frames: Vec<Frame>,
    last: u64,
    cut: u16,
    largest: usize,
}

/// A frame payload.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// Its first segment; it carries those up to the next frame's first.
    pub first: Position,
    /// Where it ends in the buffer.
    pub end: usize,
}

impl Sealed {
    /// `bytes`: the payloads one after another, divided by `frames`, in ascending order. `last`: the sequence of the last message in
    /// it. `None` without a frame.
    pub(crate) fn new(bytes: Vec<u8>, frames: Vec<Frame>, last: u64, cut: u16) -> Option<Self> {
        debug_assert!(frames.is_sorted_by(|a, b| a.first < b.first && a.end < b.end));
        let starts = std::iter::once(0).chain(frames.iter().map(|frame| frame.end));
        let largest = frames.iter().zip(starts).map(|(frame, start)| frame.end - start).max()?;
        Some(Self { bytes, frames, last, cut, largest })
    }

    /// Takes what was sealed out of `segments`; `None` if that is nothing.
    pub fn take(segments: &mut Segments) -> Option<Self> {
        let (bytes, ends) = segments.take();
        let last = segment_ids(&bytes[ends.len().checked_sub(2).map_or(0, |before| ends[before])..]).last()?;
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let frame = |(start, &end): (usize, &usize)| {
            let first = segment_ids(&bytes[start..end]).next()?;
            Some(Frame { first: Position { sequence: first.sequence, index: first.index }, end })
        };
        let frames = starts.zip(&ends).map(frame).collect::<Option<_>>()?;
        Self::new(bytes, frames, last.sequence, last.cut)
    }

    /// The sequence of the first message in it.
    pub fn first(&self) -> u64 {
        self.frames[0].first.sequence
    }

    /// The sequence of the last message in it.
    pub fn last(&self) -> u64 {
        self.last
    }

    /// How often these messages were cut before.
    pub fn cut(&self) -> u16 {
        self.cut
    }

    /// All payloads, one after another.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Number of frames: at least 1.
    pub fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Bytes of all payloads.
    pub fn total_bytes(&self) -> usize {
        self.frames.last().map_or(0, |frame| frame.end)
    }

    /// The bytes of a frame's payload.
    ///
    /// # Panics
    ///
    /// If there is no such frame.
    pub fn payload(&self, frame: usize) -> &[u8] {
        &self.bytes[self.start(frame)..self.frames[frame].end]
    }

    /// Bytes of the largest payload.
    pub(super) fn largest(&self) -> usize {
        self.largest
    }

    pub(super) fn len(&self, frame: usize) -> usize {
        self.frames[frame].end - self.start(frame)
    }

    pub(super) fn position(&self, frame: usize) -> Position {
        self.frames[frame].first
    }

    /// The frame that carries the segment at this position, if it is one of these messages.
    pub(super) fn frame_of(&self, position: Position) -> usize {
        self.frames.partition_point(|frame| frame.first <= position).saturating_sub(1)
    }

    fn start(&self, frame: usize) -> usize {
        frame.checked_sub(1).map_or(0, |before| self.frames[before].end)
    }
}
