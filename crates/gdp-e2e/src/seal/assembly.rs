//! The assembly of one message from its segments. All segments here are authentic: they opened
//! under the session's key. The reader verifies the writer's signature of the whole message last.

use super::DropReason;
use super::message::MAX_PREAMBLE;
use super::wire::{Kind, SegmentHeader};

/// Cost of an assembly besides its segments: the assembly itself, its map entry and the proof.
const FIXED_COST: usize = 1024;

#[derive(Debug)]
pub struct Assembly {
    /// Header of any of its segments.
    header: SegmentHeader,
    /// `count` slots of `size` bytes.
    buffer: Vec<u8>,
    digests: Vec<[u8; 32]>,
    received: Vec<u64>,
    missing: u32,
    last_len: usize,
    proof: Option<Vec<u8>>,
    /// Commitment to the key that the first segment opened under.
    pub commitment: [u8; 32],
    pub deadline: u64,
    pub cost: usize,
}

impl Assembly {
    /// Returns the memory charged for a message of this header's shape, or the error that it is too
    /// large. Allocates nothing.
    pub fn cost(header: &SegmentHeader, max_message: usize) -> Result<usize, DropReason> {
        let (count, size) = (header.count as usize, header.size as usize);
        let least = (count - 1).checked_mul(size).and_then(|n| n.checked_add(1)).ok_or(DropReason::TooLarge)?;
        if least > max_message.saturating_add(MAX_PREAMBLE) {
            return Err(DropReason::TooLarge);
        }
        let per_segment = size + 32 + 1;
        count.checked_mul(per_segment).and_then(|n| n.checked_add(FIXED_COST)).ok_or(DropReason::TooLarge)
    }

    pub fn new(header: &SegmentHeader, commitment: [u8; 32], deadline: u64, cost: usize) -> Self {
        let count = header.count as usize;
        Self {
            header: *header,
            // The kernel zeroes the pages on first access, so an incomplete message uses only the
            // memory of its received segments.
            buffer: vec![0; count * header.size as usize],
            digests: vec![[0; 32]; count],
            received: vec![0; count.div_ceil(64)],
            missing: header.count,
            last_len: 0,
            proof: None,
            commitment,
            deadline,
            cost,
        }
    }

    pub fn fits(&self, header: &SegmentHeader) -> bool {
        self.header.is_of_message(header)
    }

    pub fn has(&self, header: &SegmentHeader) -> bool {
        if header.kind == Kind::Proof { self.proof.is_some() } else { self.received[word(header)] & bit(header) != 0 }
    }

    /// Returns the slot of a missing body segment. Its contents do not count until [`Self::mark`].
    pub fn slot(&mut self, header: &SegmentHeader, len: usize) -> &mut [u8] {
        &mut self.buffer[header.index as usize * self.header.size as usize..][..len]
    }

    /// Records that the slot of this body segment is filled, and the digest of its ciphertext.
    pub fn mark(&mut self, header: &SegmentHeader, len: usize, digest: [u8; 32]) {
        self.received[word(header)] |= bit(header);
        self.digests[header.index as usize] = digest;
        self.missing -= 1;
        if header.index + 1 == self.header.count {
            self.last_len = len;
        }
    }

    pub fn set_proof(&mut self, proof: &[u8]) {
        self.proof = Some(proof.to_vec());
    }

    pub fn is_complete(&self) -> bool {
        self.missing == 0 && self.proof.is_some()
    }

    /// Returns plaintext, segment digests and proof of a complete message.
    pub fn into_parts(mut self) -> (Vec<u8>, Vec<[u8; 32]>, Vec<u8>) {
        let len = (self.header.count as usize - 1) * self.header.size as usize + self.last_len;
        self.buffer.truncate(len);
        (self.buffer, self.digests, self.proof.unwrap_or_default())
    }
}

fn word(header: &SegmentHeader) -> usize {
    header.index as usize / 64
}

fn bit(header: &SegmentHeader) -> u64 {
    1 << (header.index % 64)
}
