//! A sealed segment in a payload.

use super::DropReason;
use super::wire::{HEADER_LEN, Kind, SegmentHeader};
use gdp_core::crypto::{Aead, Backend, TAG_LEN};

/// Identifies a segment of a message in a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SegmentId {
    pub session: [u8; 16],
    pub sequence: u64,
    pub cut: u16,
    /// Index of the segment; that of the proof is `count`.
    pub index: u32,
    /// Number of body segments of the message, in this cut.
    pub count: u32,
    /// Length of the segment in a payload.
    pub len: usize,
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
        let header = SegmentHeader::parse(clear).ok_or(DropReason::BadHeader)?;
        let plaintext_len = header.plaintext_len().ok_or(DropReason::BadHeader)?;
        let (sealed, behind) = rest.split_at_checked(header.sealed_len.into()).ok_or(DropReason::Truncated)?;
        Ok((Self { header, clear, sealed, plaintext_len }, behind))
    }

    pub fn id(&self) -> SegmentId {
        let SegmentHeader { session, sequence, cut, index, count, .. } = self.header;
        SegmentId { session, sequence, cut, index, count, len: HEADER_LEN + self.sealed.len() }
    }

    /// Returns whether this is the proof of the message that `body` belongs to.
    pub fn proves(&self, body: &SegmentHeader) -> bool {
        self.header.kind == Kind::Proof && self.header.is_of_message(body)
    }

    /// Decrypts into `out`, which has [`Self::plaintext_len`] bytes.
    pub fn open(&self, aead: &Aead, out: &mut [u8]) -> Result<(), DropReason> {
        let (ciphertext, tag) = self.sealed.split_last_chunk::<TAG_LEN>().ok_or(DropReason::BadHeader)?;
        aead.open(&self.header.nonce(), self.clear, ciphertext, tag, out).map_err(|_| DropReason::Forged)
    }

    /// Returns the digest of ciphertext and tag.
    pub fn digest(&self, backend: Backend) -> [u8; 32] {
        backend.sha256(&[self.sealed])
    }
}
