//! One message that is being put together. All segments here are authentic (they opened under the
//! session's key); whether the writer signed the whole is the reader's last check.

use super::DropReason;
use super::message::MAX_PREAMBLE;
use super::wire::{Kind, SegmentHeader};

/// What an assembly costs besides its segments: itself, its place in the map, the proof.
const FIXED_COST: usize = 1024;

#[derive(Debug)]
pub struct Assembly {
    /// Of any of its segments.
    header: SegmentHeader,
    /// `count` slots of `size` bytes.
    buffer: Vec<u8>,
    digests: Vec<[u8; 32]>,
    received: Vec<u64>,
    missing: u32,
    last_len: usize,
    proof: Option<Vec<u8>>,
    pub deadline: u64,
    pub cost: usize,
}

impl Assembly {
    /// The memory that a message of this header's shape will be charged, or why it is too large.
    /// Nothing is allocated.
    pub fn cost(header: &SegmentHeader, max_message: usize) -> Result<usize, DropReason> {
        let (count, size) = (header.count as usize, header.size as usize);
        let least = (count - 1).checked_mul(size).and_then(|n| n.checked_add(1)).ok_or(DropReason::TooLarge)?;
        if least > max_message.saturating_add(MAX_PREAMBLE) {
            return Err(DropReason::TooLarge);
        }
        let per_segment = size + 32 + 1;
        count.checked_mul(per_segment).and_then(|n| n.checked_add(FIXED_COST)).ok_or(DropReason::TooLarge)
    }

    pub fn new(header: &SegmentHeader, deadline: u64, cost: usize) -> Self {
        let count = header.count as usize;
        Self {
            header: *header,
            // Zeroed by the kernel as it is touched: a message that stays incomplete costs what
            // arrived of it.
            buffer: vec![0; count * header.size as usize],
            digests: vec![[0; 32]; count],
            received: vec![0; count.div_ceil(64)],
            missing: header.count,
            last_len: 0,
            proof: None,
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

    /// Where a body segment that has not arrived yet belongs; its content there does not count
    /// until [`Self::mark`].
    pub fn slot(&mut self, header: &SegmentHeader, len: usize) -> &mut [u8] {
        &mut self.buffer[header.index as usize * self.header.size as usize..][..len]
    }

    /// Notes that the slot of this body segment is filled, and what its ciphertext hashes to.
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

    /// Of a complete message: plaintext, digests of the segments, proof.
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
