//! A sealed segment in a payload.

use super::DropReason;
use super::wire::{HEADER_LEN, SegmentHeader};
use gdp_core::crypto::{Aead, TAG_LEN};

/// Identifies a segment of a message in a session, or of several messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SegmentId {
    pub session: [u8; 16],
    /// Sequence of the message, or of the first one.
    pub sequence: u64,
    /// Number of consecutive messages that the segment belongs to; 0 for a heartbeat.
    pub messages: u32,
    pub cut: u16,
    pub index: u32,
    /// Number of segments of the message, in this cut.
    pub count: u32,
    /// Length of the segment in a payload.
    pub len: usize,
}

impl SegmentId {
    /// Returns the sequence of the last message that the segment belongs to.
    pub fn last(&self) -> u64 {
        self.sequence + u64::from(self.messages.saturating_sub(1))
    }
}

/// Returns the ids that the segments of a payload claim, up to the first malformed one. The ids are
/// not authenticated.
pub fn segment_ids(payload: &[u8]) -> impl Iterator<Item = SegmentId> {
    let mut rest = payload;
    std::iter::from_fn(move || {
        let (segment, behind) = Segment::split(rest).ok()?;
        rest = behind;
        Some(segment.id())
    })
}

/// A segment with consistent fields, not yet authenticated.
pub struct Segment<'a> {
    pub header: SegmentHeader,
    clear: &'a [u8; HEADER_LEN],
    /// Ciphertext and tag.
    sealed: &'a [u8],
    pub plaintext_len: usize,
}

impl<'a> Segment<'a> {
    /// Returns the first segment of `payload`, and the rest.
    pub fn split(payload: &'a [u8]) -> Result<(Self, &'a [u8]), DropReason> {
        let (clear, rest) = payload.split_first_chunk::<HEADER_LEN>().ok_or(DropReason::Truncated)?;
        let header = SegmentHeader::parse(clear)?;
        let plaintext_len = header.plaintext_len().ok_or(DropReason::BadHeader)?;
        let (sealed, behind) = rest.split_at_checked(header.sealed_len.into()).ok_or(DropReason::Truncated)?;
        Ok((Self { header, clear, sealed, plaintext_len }, behind))
    }

    pub fn id(&self) -> SegmentId {
        let SegmentHeader { session, sequence, cut, index, count, .. } = self.header;
        let (messages, len) = (self.header.messages(), HEADER_LEN + self.sealed.len());
        let count = if self.header.is_whole() { 1 } else { count };
        SegmentId { session, sequence, messages, cut, index, count, len }
    }

    /// Decrypts into `out`, which has [`Self::plaintext_len`] bytes.
    pub fn open(&self, aead: &Aead, out: &mut [u8]) -> Result<(), DropReason> {
        let (ciphertext, tag) = self.sealed.split_last_chunk::<TAG_LEN>().ok_or(DropReason::BadHeader)?;
        aead.open(&self.header.nonce(), self.clear, ciphertext, tag, out).map_err(|_| DropReason::Forged)
    }
}
