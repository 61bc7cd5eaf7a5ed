//! The frame payloads that a message became, in one buffer that is reused from message to message.

use super::segment::{Segment, SegmentId};

/// Sealed segments, packed into frame payloads of a given size. Reused, it stops allocating after
/// the largest message.
#[derive(Clone, Debug, Default)]
pub struct Segments {
    buffer: Vec<u8>,
    /// Where in `buffer` each payload ends.
    ends: Vec<usize>,
}

impl Segments {
    pub fn new() -> Self {
        Self::default()
    }

    /// The frame payloads, in the order in which they are best sent.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[u8]> {
        let mut start = 0;
        self.ends.iter().map(move |&end| {
            let payload = &self.buffer[start..end];
            start = end;
            payload
        })
    }

    /// The sealed segments, each with its bytes, in the order in which they are in the payloads:
    /// for a history from which single ones are sent again.
    pub fn segments(&self) -> impl Iterator<Item = (SegmentId, &[u8])> {
        let mut rest = &self.buffer[..];
        std::iter::from_fn(move || {
            let (segment, behind) = Segment::split(rest).ok()?;
            let (bytes, _) = rest.split_at(rest.len() - behind.len());
            rest = behind;
            Some((segment.id(), bytes))
        })
    }

    /// The bytes of all frame payloads, one after another.
    pub fn into_bytes(self) -> Vec<u8> {
        self.buffer
    }

    /// Number of frame payloads.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Bytes of all frame payloads together.
    pub fn total_bytes(&self) -> usize {
        self.buffer.len()
    }

    pub fn clear(&mut self) {
        self.buffer.clear();
        self.ends.clear();
    }

    /// Makes room for a segment of `len` bytes and returns where it begins; opens a new payload if
    /// the last has no room. The caller appends exactly `len` bytes to [`Self::buffer`].
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
