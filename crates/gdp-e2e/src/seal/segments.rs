//! The frame payloads of a message, in one buffer that is reused for every message.

use super::segment::{Segment, SegmentId};

/// Sealed segments, packed into frame payloads of a given size. A reused value stops allocating
/// after the largest message.
#[derive(Clone, Debug, Default)]
pub struct Segments {
    buffer: Vec<u8>,
    /// End offset of each payload in `buffer`.
    ends: Vec<usize>,
}

impl Segments {
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the frame payloads in the recommended order of sending.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[u8]> {
        let mut start = 0;
        self.ends.iter().map(move |&end| {
            let payload = &self.buffer[start..end];
            start = end;
            payload
        })
    }

    /// Returns the sealed segments with their bytes, in the order of the payloads. For a history
    /// that repeats single segments.
    pub fn segments(&self) -> impl Iterator<Item = (SegmentId, &[u8])> {
        let mut rest = &self.buffer[..];
        std::iter::from_fn(move || {
            let (segment, behind) = Segment::split(rest).ok()?;
            let (bytes, _) = rest.split_at(rest.len() - behind.len());
            rest = behind;
            Some((segment.id(), bytes))
        })
    }

    /// Returns all frame payloads, concatenated.
    pub fn into_bytes(self) -> Vec<u8> {
        self.buffer
    }

    /// Returns the number of frame payloads.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Returns the total length of all frame payloads.
    pub fn total_bytes(&self) -> usize {
        self.buffer.len()
    }

    pub fn clear(&mut self) {
        self.buffer.clear();
        self.ends.clear();
    }

    /// Reserves room for a segment of `len` bytes and returns its offset. Starts a new payload if
    /// the last one has no room. The caller must append exactly `len` bytes to [`Self::buffer`].
    pub(super) fn begin(&mut self, len: usize, max_payload: usize) -> usize {
        let at = self.buffer.len();
        let payload_start = self.ends.len().checked_sub(2).map_or(0, |i| self.ends[i]);
        match self.ends.last_mut() {
            Some(end) if at - payload_start + len <= max_payload => *end = at + len,
            _ => self.ends.push(at + len),
        }
        self.buffer.reserve(len);
        at
    }

    pub(super) fn buffer(&mut self) -> &mut Vec<u8> {
        &mut self.buffer
    }
}
