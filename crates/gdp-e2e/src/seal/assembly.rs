//! The assembly of one message from its segments. All segments here are authentic: they opened
//! under the session's key. The reader verifies the writer's signature of the whole message last.

use super::DropReason;
use super::message::MAX_PREAMBLE;
use super::wire::SegmentHeader;

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
    /// Bytes of the last two segments. The others are full.
    last_lens: [usize; 2],
    proof: Vec<u8>,
    /// Commitment to the key that the first segment opened under.
    pub commitment: [u8; 32],
    pub deadline: u64,
    pub cost: usize,
}

/// A complete message.
pub struct Assembled {
    pub plaintext: Vec<u8>,
    pub digests: Vec<[u8; 32]>,
    pub proof: Vec<u8>,
    pub commitment: [u8; 32],
}

impl Assembly {
    /// Returns the memory charged for a message of this header's shape, or the error that it is too
    /// large. Allocates nothing.
    pub fn cost(header: &SegmentHeader, max_message: usize) -> Result<usize, DropReason> {
        let (count, size) = (header.count as usize, header.size as usize);
        let full = count.saturating_sub(2);
        let least = full.checked_mul(size).and_then(|n| n.checked_add(1)).ok_or(DropReason::TooLarge)?;
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
            last_lens: [header.size as usize, 0],
            proof: Vec::new(),
            commitment,
            deadline,
            cost,
        }
    }

    pub fn fits(&self, header: &SegmentHeader) -> bool {
        self.header.is_of_message(header)
    }

    pub fn has(&self, header: &SegmentHeader) -> bool {
        self.received[word(header)] & bit(header) != 0
    }

    /// Returns the slot of a missing segment. Its contents do not count until [`Self::mark`].
    pub fn slot(&mut self, header: &SegmentHeader, len: usize) -> &mut [u8] {
        &mut self.buffer[header.index as usize * self.header.size as usize..][..len]
    }

    /// Records that the slot of this segment is filled, and the digest of its plaintext.
    pub fn mark(&mut self, header: &SegmentHeader, len: usize, digest: [u8; 32]) {
        self.received[word(header)] |= bit(header);
        self.digests[header.index as usize] = digest;
        self.missing -= 1;
        match self.header.count - header.index {
            1 => self.last_lens[1] = len,
            2 => self.last_lens[0] = len,
            _ => {}
        }
    }

    pub fn set_proof(&mut self, proof: &[u8]) {
        self.proof = proof.to_vec();
    }

    pub fn is_complete(&self) -> bool {
        self.missing == 0
    }

    /// Returns a complete message, or `None` if its segments leave a gap.
    pub fn into_message(mut self) -> Option<Assembled> {
        let size = self.header.size as usize;
        let [before_last, last] = self.last_lens;
        if last > 0 && before_last < size {
            return None;
        }
        self.buffer.truncate((self.header.count as usize - 2) * size + before_last + last);
        let Self { buffer: plaintext, digests, proof, commitment, .. } = self;
        Some(Assembled { plaintext, digests, proof, commitment })
    }
}

fn word(header: &SegmentHeader) -> usize {
    header.index as usize / 64
}

fn bit(header: &SegmentHeader) -> u64 {
    1 << (header.index % 64)
}
