//! The layouts of `docs/wire-format.md`, "Sealed segments": segment header, proof, heartbeat, and
//! the hashes that bind them. Only encoding and bounds; the module has no state. All integers are
//! big-endian.

use gdp_core::crypto::{Backend, NONCE_LEN, SIGNATURE_LEN, TAG_LEN};
use gdp_core::name::Name;

const MESSAGE_CONTEXT: &[u8] = b"gdp/message/2";
const BATCH_CONTEXT: &[u8] = b"gdp/batch/2";
const HEARTBEAT_CONTEXT: &[u8] = b"gdp/heartbeat/1";

pub const VERSION: u8 = 3;
const FLAG_PROOF: u8 = 1;
const FLAG_HEARTBEAT: u8 = 2;
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
const HEARTBEAT_CUT: u16 = u16::MAX;

pub const MAX_DEPTH: usize = 16;
/// Maximum number of messages under one signature.
pub const MAX_BATCH: usize = 1 << MAX_DEPTH;

/// The smallest frame payload that a message can be cut for. It fits the proof of a message that is
/// signed alone.
pub const MIN_PAYLOAD: usize = OVERHEAD + proof_len(0);

/// The contents of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A part of a message.
    Body,
    /// The position of the message in a signed tree.
    Proof,
    /// The progress of the session.
    Heartbeat,
}

/// The clear header before every segment's ciphertext, authenticated as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentHeader {
    pub kind: Kind,
    /// Length of the ciphertext including its tag.
    pub sealed_len: u16,
    /// Index of the segment; for a heartbeat, its number in the session.
    pub index: u32,
    /// Sequence of the message; for a heartbeat, that of the next message. 48 bits.
    pub sequence: u64,
    /// Number of earlier cuts of the message. Heartbeats use a reserved cut.
    pub cut: u16,
    pub session: [u8; 16],
    /// Number of body segments of the message, without the proof.
    pub count: u32,
    /// Plaintext bytes of every body segment except the last, which may be shorter.
    pub size: u32,
    /// Epoch of the writer's key that the segment is sealed under.
    pub epoch: u32,
}

impl SegmentHeader {
    /// Returns the header of the `number`th heartbeat of a session.
    pub fn heartbeat(session: [u8; 16], number: u32, next: u64, epoch: u32) -> Self {
        Self {
            kind: Kind::Heartbeat,
            sealed_len: (HEARTBEAT_LEN + TAG_LEN) as u16,
            index: number,
            sequence: next,
            cut: HEARTBEAT_CUT,
            session,
            count: 0,
            size: 0,
            epoch,
        }
    }

    pub fn to_bytes(self) -> [u8; HEADER_LEN] {
        let mut bytes = [0u8; HEADER_LEN];
        bytes[0] = VERSION;
        bytes[1] = match self.kind {
            Kind::Body => 0,
            Kind::Proof => FLAG_PROOF,
            Kind::Heartbeat => FLAG_HEARTBEAT,
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

    /// Returns `None` for another version or unknown flags.
    pub fn parse(bytes: &[u8; HEADER_LEN]) -> Option<Self> {
        let word = |at: usize| u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let kind = match (bytes[0], bytes[1]) {
            (VERSION, 0) => Kind::Body,
            (VERSION, FLAG_PROOF) => Kind::Proof,
            (VERSION, FLAG_HEARTBEAT) => Kind::Heartbeat,
            _ => return None,
        };
        let mut session = [0u8; 16];
        session.copy_from_slice(&bytes[16..32]);
        Some(Self {
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
        let fits = match self.kind {
            Kind::Body if self.index.checked_add(1)? == self.count => of_message && (1..=size).contains(&len),
            Kind::Body => of_message && self.index < self.count && len == size,
            Kind::Proof => of_message && self.index == self.count && is_proof_len(len),
            Kind::Heartbeat => {
                self.cut == HEARTBEAT_CUT && self.count == 0 && size == 0 && self.index > 0 && len == HEARTBEAT_LEN
            }
        };
        (fits && self.sequence > 0).then_some(len)
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

const PROOF_HEADER_LEN: usize = 4;

/// Returns the plaintext length of a proof with a path of `depth` hashes.
pub const fn proof_len(depth: usize) -> usize {
    PROOF_HEADER_LEN + 32 * depth + SIGNATURE_LEN
}

fn is_proof_len(len: usize) -> bool {
    len >= proof_len(0) && len <= proof_len(MAX_DEPTH) && (len - proof_len(0)).is_multiple_of(32)
}

/// The position of the message's leaf in the signed tree, the path to the root, and the signature
/// of the root.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Proof<'a> {
    pub position: u16,
    pub path: &'a [[u8; 32]],
    pub signature: &'a [u8; SIGNATURE_LEN],
}

impl<'a> Proof<'a> {
    /// Writes the proof into `out`, which has [`proof_len`] bytes.
    pub fn write(&self, out: &mut [u8]) {
        out[..2].copy_from_slice(&self.position.to_be_bytes());
        out[2] = self.path.len() as u8;
        out[3] = 0;
        let (path, signature) = out[PROOF_HEADER_LEN..].split_at_mut(32 * self.path.len());
        path.copy_from_slice(self.path.as_flattened());
        signature.copy_from_slice(self.signature);
    }

    pub fn parse(plaintext: &'a [u8]) -> Option<Self> {
        let (&[p0, p1, depth, reserved], rest) = plaintext.split_first_chunk::<PROOF_HEADER_LEN>()?;
        let depth = usize::from(depth);
        if reserved != 0 || depth > MAX_DEPTH || plaintext.len() != proof_len(depth) {
            return None;
        }
        let (path, signature) = rest.split_at_checked(32 * depth)?;
        let position = u16::from_be_bytes([p0, p1]);
        (u32::from(position) >> depth == 0).then_some(Self {
            position,
            path: path.as_chunks::<32>().0,
            signature: signature.try_into().ok()?,
        })
    }
}

/// Returns the leaf of a message in the signed tree. `commitment` is that of the session's key, and
/// `digests` are the SHA-256 of each body segment's ciphertext with its tag, in order.
///
/// Without the commitment, a writer could give readers different keys under which one ciphertext
/// opens to different messages, all below one valid signature.
pub fn leaf(
    backend: Backend,
    commitment: &[u8; 32],
    (name, writer): (&Name, &Name),
    header: &SegmentHeader,
    digests: &[[u8; 32]],
) -> [u8; 32] {
    // Sequence, cut, session, count, size and epoch.
    let message = &header.to_bytes()[8..];
    let (name, writer) = (name.as_bytes(), writer.as_bytes());
    backend.sha256(&[&[0], MESSAGE_CONTEXT, commitment, name, writer, message, digests.as_flattened()])
}

/// Returns the signed statement for the tree with this root.
pub fn batch_statement(root: &[u8; 32]) -> [u8; BATCH_CONTEXT.len() + 32] {
    let mut statement = [0u8; BATCH_CONTEXT.len() + 32];
    statement[..BATCH_CONTEXT.len()].copy_from_slice(BATCH_CONTEXT);
    statement[BATCH_CONTEXT.len()..].copy_from_slice(root);
    statement
}

/// Plaintext bytes of a heartbeat.
pub const HEARTBEAT_LEN: usize = HEARTBEAT_CLAIMS + SIGNATURE_LEN;
const HEARTBEAT_CLAIMS: usize = 16;
const HEARTBEAT_STATEMENT: usize = HEARTBEAT_CONTEXT.len() + 64 + 28 + HEARTBEAT_CLAIMS;

/// The contents of a heartbeat in addition to its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeartbeatBody {
    pub timestamp_ns: u64,
    /// The sequence of the oldest message that the writer can repeat.
    pub oldest: u64,
}

impl HeartbeatBody {
    /// Returns the plaintext. `signature` is that of the [statement](Self::statement).
    pub fn to_bytes(self, signature: &[u8; SIGNATURE_LEN]) -> [u8; HEARTBEAT_LEN] {
        let mut bytes = [0u8; HEARTBEAT_LEN];
        bytes[..HEARTBEAT_CLAIMS].copy_from_slice(&self.claims());
        bytes[HEARTBEAT_CLAIMS..].copy_from_slice(signature);
        bytes
    }

    pub fn parse(plaintext: &[u8]) -> Option<(Self, &[u8; SIGNATURE_LEN])> {
        let (&[t0, t1, t2, t3, t4, t5, t6, t7, o0, o1, o2, o3, o4, o5, o6, o7], signature) =
            plaintext.split_first_chunk::<HEARTBEAT_CLAIMS>()?;
        let timestamp_ns = u64::from_be_bytes([t0, t1, t2, t3, t4, t5, t6, t7]);
        let oldest = u64::from_be_bytes([o0, o1, o2, o3, o4, o5, o6, o7]);
        Some((Self { timestamp_ns, oldest }, signature.try_into().ok()?))
    }

    /// Returns the statement that the writer signs.
    pub fn statement(&self, name: &Name, writer: &Name, header: &SegmentHeader) -> [u8; HEARTBEAT_STATEMENT] {
        let mut statement = [0u8; HEARTBEAT_STATEMENT];
        let mut rest = &mut statement[..];
        // Number, next sequence and session from the header.
        let parts: [&[u8]; 5] =
            [HEARTBEAT_CONTEXT, name.as_bytes(), writer.as_bytes(), &header.to_bytes()[4..32], &self.claims()];
        for part in parts {
            let (place, behind) = rest.split_at_mut(part.len());
            place.copy_from_slice(part);
            rest = behind;
        }
        statement
    }

    fn claims(&self) -> [u8; HEARTBEAT_CLAIMS] {
        let mut claims = [0u8; HEARTBEAT_CLAIMS];
        claims[..8].copy_from_slice(&self.timestamp_ns.to_be_bytes());
        claims[8..].copy_from_slice(&self.oldest.to_be_bytes());
        claims
    }
}

#[cfg(test)]
#[path = "../../tests/unit/seal/wire.rs"]
mod tests;
