//! The layouts of `docs/wire-format.md`, "Sealed segments": segment header, proof, and the hashes
//! that bind them. Only encoding and bounds; the module has no state. All integers are big-endian.

use super::DropReason;
use super::message::{BUNDLED_HEADER_LEN, TIMESTAMP_LEN};
use gdp_core::crypto::{self, NONCE_LEN, SIGNATURE_LEN, TAG_LEN};
use gdp_core::name::Name;

const MESSAGE_CONTEXT: &[u8] = b"gdp/message/2";
const BUNDLE_CONTEXT: &[u8] = b"gdp/bundle/2";
const BATCH_CONTEXT: &[u8] = b"gdp/batch/2";

pub const VERSION: u8 = 3;
/// The low bits of the second byte are the kind. The high bits are flags that no reader needs to
/// know, so that readers skip unknown ones.
const KIND: u8 = 0x0f;
pub const HEADER_LEN: usize = 44;
/// Overhead of a segment besides its plaintext.
pub const OVERHEAD: usize = HEADER_LEN + TAG_LEN;
/// The largest plaintext of a segment. Its length including the tag has 16 bits.
pub const MAX_PLAINTEXT: usize = u16::MAX as usize - TAG_LEN;

/// The last sequence of a session. Sequences have 48 bits.
pub const MAX_SEQUENCE: u64 = (1 << 48) - 1;
/// The last cut of a message.
pub const MAX_CUT: u16 = u16::MAX - 1;
/// The cut of all heartbeats, so that their nonces differ from those of messages.
pub const HEARTBEAT_CUT: u16 = u16::MAX;

/// Plaintext bytes of a heartbeat before its signature, and in all.
pub const HEARTBEAT_CLAIMS: usize = 16;
pub const HEARTBEAT_LEN: usize = HEARTBEAT_CLAIMS + SIGNATURE_LEN;

pub const MAX_DEPTH: usize = 16;
/// Maximum number of messages under one signature.
pub const MAX_BATCH: usize = 1 << MAX_DEPTH;

/// The smallest frame payload that a message can be cut for. It fits the proof of a message that is
/// signed alone.
pub const MIN_PAYLOAD: usize = OVERHEAD + proof_len(0);

/// The contents of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A part of a message, but not its end.
    Body,
    /// The end of a message, possibly empty, and the message's proof.
    Last,
    /// The progress of the session.
    Heartbeat,
    /// Several whole messages and their common proof.
    Bundle,
}

/// The clear header before every segment's ciphertext, authenticated as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentHeader {
    pub kind: Kind,
    /// Length of the ciphertext including its tag.
    pub sealed_len: u16,
    /// Index of the segment; of a bundle: 0; of a heartbeat: its number in the session.
    pub index: u32,
    /// Sequence of the message, of a bundle's first message, or of the message after a heartbeat.
    /// 48 bits.
    pub sequence: u64,
    /// Number of earlier cuts of the message. Heartbeats use a reserved cut.
    pub cut: u16,
    pub session: [u8; 16],
    /// Number of segments of the message, or of messages in a bundle.
    pub count: u32,
    /// Plaintext bytes of a message in each of its segments but the last ones, which may be
    /// shorter; of a bundle: plaintext bytes of its messages.
    pub size: u32,
    /// Epoch of the writer's key that the segment is sealed under.
    pub epoch: u32,
}

impl SegmentHeader {
    pub fn to_bytes(self) -> [u8; HEADER_LEN] {
        let mut bytes = [0u8; HEADER_LEN];
        bytes[0] = VERSION;
        bytes[1] = match self.kind {
            Kind::Body => 0,
            Kind::Last => 1,
            Kind::Heartbeat => 2,
            Kind::Bundle => 3,
        };
        bytes[2..4].copy_from_slice(&self.sealed_len.to_be_bytes());
        bytes[4..8].copy_from_slice(&self.index.to_be_bytes());
        bytes[8..16].copy_from_slice(&self.sequence_and_cut());
        bytes[16..32].copy_from_slice(&self.session);
        bytes[32..36].copy_from_slice(&self.count.to_be_bytes());
        bytes[36..40].copy_from_slice(&self.size.to_be_bytes());
        bytes[40..44].copy_from_slice(&self.epoch.to_be_bytes());
        bytes
    }

    /// Fails for another version and for unknown kinds. Skips unknown flags.
    pub fn parse(bytes: &[u8; HEADER_LEN]) -> Result<Self, DropReason> {
        let word = |at: usize| u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        if bytes[0] != VERSION {
            return Err(DropReason::OtherVersion);
        }
        let kind = match bytes[1] & KIND {
            0 => Kind::Body,
            1 => Kind::Last,
            2 => Kind::Heartbeat,
            3 => Kind::Bundle,
            _ => return Err(DropReason::Unsupported),
        };
        let mut session = [0u8; 16];
        session.copy_from_slice(&bytes[16..32]);
        Ok(Self {
            kind,
            sealed_len: u16::from_be_bytes([bytes[2], bytes[3]]),
            index: word(4),
            sequence: u64::from(word(8)) << 16 | u64::from(word(12)) >> 16,
            cut: word(12) as u16,
            session,
            count: word(32),
            size: word(36),
            epoch: word(40),
        })
    }

    /// Returns the plaintext length of this segment, if all fields are consistent.
    pub fn plaintext_len(&self) -> Option<usize> {
        let len = usize::from(self.sealed_len).checked_sub(TAG_LEN)?;
        let size = self.size as usize;
        let of_message = self.cut <= MAX_CUT && self.count > 0 && (1..=MAX_PLAINTEXT).contains(&size);
        let behind = self.index.checked_add(1)?;
        let fits = match self.kind {
            // If the end of the message leaves no room for the proof, it comes in the segment
            // before the last.
            Kind::Body if behind.checked_add(1)? == self.count => of_message && (1..=size).contains(&len),
            Kind::Body => of_message && behind < self.count && len == size,
            Kind::Last if self.count == 1 => of_message && self.index == 0 && is_proof_len(len.checked_sub(size)?),
            Kind::Last => {
                of_message && behind == self.count && (proof_len(0)..=size + proof_len(MAX_DEPTH)).contains(&len)
            }
            Kind::Bundle => {
                let behind = self.sequence.checked_add(self.count.into())?;
                // What follows from the count must not cost more than the segment itself.
                let has_room = self.count as usize <= size.saturating_sub(TIMESTAMP_LEN) / BUNDLED_HEADER_LEN;
                let is_bundle = of_message && self.count > 1 && has_room && behind <= MAX_SEQUENCE + 1;
                is_bundle && self.index == 0 && is_proof_len(len.checked_sub(size)?)
            }
            Kind::Heartbeat => {
                self.cut == HEARTBEAT_CUT && self.count == 0 && size == 0 && self.index > 0 && len == HEARTBEAT_LEN
            }
        };
        (fits && self.sequence > 0).then_some(len)
    }

    /// Returns whether the segment by itself is one message or several.
    pub fn is_whole(&self) -> bool {
        match self.kind {
            Kind::Last => self.count == 1,
            Kind::Bundle => true,
            Kind::Body | Kind::Heartbeat => false,
        }
    }

    /// Returns the number of messages of which the segment is a part.
    pub fn messages(&self) -> u32 {
        match self.kind {
            Kind::Body | Kind::Last => 1,
            Kind::Bundle => self.count,
            Kind::Heartbeat => 0,
        }
    }

    /// Returns whether `other` is a segment of the same message, in the same cut and under the same
    /// key.
    pub fn is_of_message(&self, other: &Self) -> bool {
        let message =
            |header: &Self| (header.session, header.sequence, header.cut, header.count, header.size, header.epoch);
        message(self) == message(other)
    }

    pub fn nonce(&self) -> [u8; NONCE_LEN] {
        let mut nonce = [0u8; NONCE_LEN];
        nonce[..8].copy_from_slice(&self.sequence_and_cut());
        nonce[8..].copy_from_slice(&self.index.to_be_bytes());
        nonce
    }

    fn sequence_and_cut(&self) -> [u8; 8] {
        (self.sequence << 16 | u64::from(self.cut)).to_be_bytes()
    }
}

/// Bytes behind path and signature: position, depth, and one reserved byte.
const PROOF_END_LEN: usize = 4;

/// Returns the length of a proof with a path of `depth` hashes.
pub const fn proof_len(depth: usize) -> usize {
    32 * depth + SIGNATURE_LEN + PROOF_END_LEN
}

fn is_proof_len(len: usize) -> bool {
    len >= proof_len(0) && len <= proof_len(MAX_DEPTH) && (len - proof_len(0)).is_multiple_of(32)
}

/// The path from the leaf to the root of the signed tree, the signature of the root, and the leaf's
/// position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Proof<'a> {
    pub position: u16,
    pub path: &'a [[u8; 32]],
    pub signature: &'a [u8; SIGNATURE_LEN],
}

impl<'a> Proof<'a> {
    /// Writes the proof into `out`, which has [`proof_len`] bytes.
    pub fn write(&self, out: &mut [u8]) {
        let (path, rest) = out.split_at_mut(32 * self.path.len());
        let (signature, end) = rest.split_at_mut(SIGNATURE_LEN);
        path.copy_from_slice(self.path.as_flattened());
        signature.copy_from_slice(self.signature);
        let [high, low] = self.position.to_be_bytes();
        end.copy_from_slice(&[high, low, self.path.len() as u8, 0]);
    }

    /// Splits the plaintext of a segment into its part of the message, and the proof at its end.
    pub fn split(plaintext: &'a [u8]) -> Option<(&'a [u8], Self)> {
        let (rest, &[p0, p1, depth, reserved]) = plaintext.split_last_chunk::<PROOF_END_LEN>()?;
        let (rest, signature) = rest.split_last_chunk::<SIGNATURE_LEN>()?;
        let depth = usize::from(depth);
        if reserved != 0 || depth > MAX_DEPTH {
            return None;
        }
        let (part, path) = rest.split_at_checked(rest.len().checked_sub(32 * depth)?)?;
        let position = u16::from_be_bytes([p0, p1]);
        let proof = Self { position, path: path.as_chunks::<32>().0, signature };
        (u32::from(position) >> depth == 0).then_some((part, proof))
    }
}

/// Returns the leaf of a message or a bundle in the signed tree. `commitment` is that of the
/// session's key, and `digests` are the SHA-256 of each segment's plaintext without the proof, in
/// order.
///
/// The commitment binds the signature to the key, so that a message that was signed under one key
/// of an epoch does not count under another one.
pub fn leaf(
    commitment: &[u8; 32],
    (name, writer): (&Name, &Name),
    header: &SegmentHeader,
    digests: &[[u8; 32]],
) -> [u8; 32] {
    let context = if header.kind == Kind::Bundle { BUNDLE_CONTEXT } else { MESSAGE_CONTEXT };
    // Sequence, cut, session, count, size and epoch.
    let message = &header.to_bytes()[8..];
    let (name, writer) = (name.as_bytes(), writer.as_bytes());
    crypto::sha256(&[&[0], context, commitment, name, writer, message, digests.as_flattened()])
}

/// Returns the signed statement for the tree with this root.
pub fn batch_statement(root: &[u8; 32]) -> [u8; BATCH_CONTEXT.len() + 32] {
    let mut statement = [0u8; BATCH_CONTEXT.len() + 32];
    statement[..BATCH_CONTEXT.len()].copy_from_slice(BATCH_CONTEXT);
    statement[BATCH_CONTEXT.len()..].copy_from_slice(root);
    statement
}

#[cfg(test)]
#[path = "../../tests/unit/seal/wire.rs"]
mod tests;
