//! A sealed message as seen by the transport: frame payloads, and the segments in each.

use crate::seal::Segments;

/// The position of a segment in its session. The order of positions is the order of sending. A
/// bundle is at the position of its first message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    pub sequence: u64,
    pub index: u32,
}

/// A message, or several under one signature, divided into frame payloads.
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
    /// Position of the first segment. The frame carries all segments up to the first one of the
    /// next frame.
    pub first: Position,
    /// End offset in the buffer.
    pub end: usize,
}

impl Sealed {
    /// Takes the segments from [`crate::seal::Writer`]. Returns `None` if there are none.
    pub fn new(segments: Segments) -> Option<Self> {
        let mut frames = Vec::with_capacity(segments.len());
        let (mut start, mut at, mut last, mut cut) = (0, 0, 0, 0);
        let mut ends = segments.iter().map(<[u8]>::len);
        for (id, bytes) in segments.segments() {
            if at == start {
                start += ends.next()?;
                frames.push(Frame { first: Position { sequence: id.sequence, index: id.index }, end: start });
            }
            at += bytes.len();
            (last, cut) = (id.last(), id.cut);
        }
        drop(ends);
        (at > 0).then(|| Self::from_frames(segments.into_bytes(), frames, last, cut))
    }

    /// For simulations, where a payload consists of its length only.
    #[cfg(test)]
    pub(super) fn without_bytes(frames: Vec<Frame>, last: u64, cut: u16) -> Self {
        Self::from_frames(Vec::new(), frames, last, cut)
    }

    fn from_frames(bytes: Vec<u8>, frames: Vec<Frame>, last: u64, cut: u16) -> Self {
        debug_assert!(frames.is_sorted_by(|a, b| a.first < b.first && a.end < b.end));
        let starts = std::iter::once(0).chain(frames.iter().map(|frame| frame.end));
        let largest = frames.iter().zip(starts).map(|(frame, start)| frame.end - start).max().unwrap_or(0);
        Self { bytes, frames, last, cut, largest }
    }

    /// Returns the sequence of the first message.
    pub fn first(&self) -> u64 {
        self.frames[0].first.sequence
    }

    /// Returns the sequence of the last message.
    pub fn last(&self) -> u64 {
        self.last
    }

    /// Returns how often these messages were cut before.
    pub fn cut(&self) -> u16 {
        self.cut
    }

    /// Returns all payloads, concatenated.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Returns the total length of all payloads.
    pub fn total_bytes(&self) -> usize {
        self.frames.last().map_or(0, |frame| frame.end)
    }

    /// Returns the payload of a frame.
    ///
    /// # Panics
    ///
    /// If there is no such frame.
    pub fn payload(&self, frame: usize) -> &[u8] {
        &self.bytes[self.start(frame)..self.frames[frame].end]
    }

    /// Returns the length of the largest payload.
    pub(super) fn largest(&self) -> usize {
        self.largest
    }

    pub(super) fn len(&self, frame: usize) -> usize {
        self.frames[frame].end - self.start(frame)
    }

    pub(super) fn position(&self, frame: usize) -> Position {
        self.frames[frame].first
    }

    /// Returns the frame that carries the segment at this position, if it is in one of these
    /// messages.
    pub(super) fn frame_of(&self, position: Position) -> usize {
        self.frames.partition_point(|frame| frame.first <= position).saturating_sub(1)
    }

    fn start(&self, frame: usize) -> usize {
        frame.checked_sub(1).map_or(0, |before| self.frames[before].end)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/transport/sealed.rs"]
mod tests;
