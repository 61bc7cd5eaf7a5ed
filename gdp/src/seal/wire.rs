//! The layouts of `docs/wire-format.md`, "Sealed segments": segment header, message header, proof, and the hashes that
//! bind them. Encoding and bounds only; nothing here keeps state. All integers are big-endian.

use crate::crypto::{Backend, NONCE_LEN, SIGNATURE_LEN, TAG_LEN};
use crate::name::Name;

pub const SESSION_CONTEXT: &[u8] = b"gdp/session/1";
const MESSAGE_CONTEXT: &[u8] = b"gdp/message/1";
const BATCH_CONTEXT: &[u8] = b"gdp/batch/1";

pub const VERSION: u8 = 1;
pub const FLAG_PROOF: u8 = 1;
pub const HEADER_LEN: usize = 40;
/// What a segment costs besides its plaintext.
pub const OVERHEAD: usize = HEADER_LEN + TAG_LEN;
/// The largest plaintext of a segment: its length with the tag is 16 bits.
pub const MAX_PLAINTEXT: usize = u16::MAX as usize - TAG_LEN;

pub const MAX_DEPTH: usize = 16;
/// The most messages that one signature may cover.
pub const MAX_BATCH: usize = 1 << MAX_DEPTH;

/// The smallest frame payload a message can be cut for: one that holds the proof of a message signed alone.
pub const MIN_PAYLOAD: usize = OVERHEAD + proof_len(0);

/// The clear header in front of every segment's ciphertext; all of it is authenticated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentHeader {
    pub proof: bool,
    /// Of the ciphertext with its tag.
    pub sealed_len: u16,
    pub index: u32,
    pub sequence: u64,
    pub session: [u8; 16],
    /// Body segments of the message, without the proof.
    pub count: u32,
    /// Plaintext bytes of every body segment but the last, which may have fewer.
    pub size: u32,
}

impl SegmentHeader {
    pub fn to_bytes(self) -> [u8; HEADER_LEN] {
        let mut bytes = [0u8; HEADER_LEN];
        bytes[0] = VERSION;
        bytes[1] = if self.proof { FLAG_PROOF } else { 0 };
        bytes[2..4].copy_from_slice(&self.sealed_len.to_be_bytes());
        bytes[4..8].copy_from_slice(&self.index.to_be_bytes());
        bytes[8..16].copy_from_slice(&self.sequence.to_be_bytes());
        bytes[16..32].copy_from_slice(&self.session);
        bytes[32..36].copy_from_slice(&self.count.to_be_bytes());
        bytes[36..40].copy_from_slice(&self.size.to_be_bytes());
        bytes
    }

    /// `None` for another version or unknown flags.
    pub fn parse(bytes: &[u8; HEADER_LEN]) -> Option<Self> {
        let at = |from: usize| -> [u8; 4] { [bytes[from], bytes[from + 1], bytes[from + 2], bytes[from + 3]] };
        let mut session = [0u8; 16];
        session.copy_from_slice(&bytes[16..32]);
        (bytes[0] == VERSION && bytes[1] & !FLAG_PROOF == 0).then(|| Self {
            proof: bytes[1] == FLAG_PROOF,
            sealed_len: u16::from_be_bytes([bytes[2], bytes[3]]),
            index: u32::from_be_bytes(at(4)),
            sequence: u64::from(u32::from_be_bytes(at(8))) << 32 | u64::from(u32::from_be_bytes(at(12))),
            session,
            count: u32::from_be_bytes(at(32)),
            size: u32::from_be_bytes(at(36)),
        })
    }

    /// Plaintext bytes of this segment, if all fields fit each other.
    pub fn plaintext_len(&self) -> Option<usize> {
        let len = usize::from(self.sealed_len).checked_sub(TAG_LEN)?;
        let size = self.size as usize;
        let fits = if self.proof {
            self.index == self.count && is_proof_len(len)
        } else if self.index.checked_add(1)? == self.count {
            (1..=size).contains(&len)
        } else {
            self.index < self.count && len == size
        };
        let sane = self.count > 0 && self.sequence > 0 && (1..=MAX_PLAINTEXT).contains(&size);
        (fits && sane).then_some(len)
    }

    pub fn nonce(&self) -> [u8; NONCE_LEN] {
        let mut nonce = [0u8; NONCE_LEN];
        nonce[..8].copy_from_slice(&self.sequence.to_be_bytes());
        nonce[8..].copy_from_slice(&self.index.to_be_bytes());
        nonce
    }
}

pub const MESSAGE_HEADER_LEN: usize = 16;

/// The plaintext of a message begins with this, then extensions, then the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageHeader {
    pub timestamp_ns: u64,
    pub encoding: Encoding,
    /// Bytes between this header and the body. This version writes none and skips those of later ones.
    pub extensions_len: u16,
}

impl MessageHeader {
    pub fn to_bytes(self) -> [u8; MESSAGE_HEADER_LEN] {
        let mut bytes = [0u8; MESSAGE_HEADER_LEN];
        bytes[..8].copy_from_slice(&self.timestamp_ns.to_be_bytes());
        bytes[8..10].copy_from_slice(&u16::from(self.encoding).to_be_bytes());
        bytes[10..12].copy_from_slice(&self.extensions_len.to_be_bytes());
        bytes
    }

    /// The header, and where in `plaintext` the body begins.
    pub fn parse(plaintext: &[u8]) -> Option<(Self, usize)> {
        let (bytes, rest) = plaintext.split_first_chunk::<MESSAGE_HEADER_LEN>()?;
        let [t0, t1, t2, t3, t4, t5, t6, t7, e0, e1, x0, x1, reserved @ ..] = *bytes;
        let header = Self {
            timestamp_ns: u64::from_be_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
            encoding: u16::from_be_bytes([e0, e1]).into(),
            extensions_len: u16::from_be_bytes([x0, x1]),
        };
        let fits = reserved == [0; 4] && usize::from(header.extensions_len) <= rest.len();
        fits.then(|| (header, MESSAGE_HEADER_LEN + usize::from(header.extensions_len)))
    }
}

/// How the body of a message is encoded (DESIGN §10).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// Bytes that only the application understands.
    Bytes,
    Json,
    Cdr,
    Ros1,
    /// Of a later version, or private use.
    Other(u16),
}

impl From<Encoding> for u16 {
    fn from(encoding: Encoding) -> Self {
        match encoding {
            Encoding::Bytes => 0,
            Encoding::Json => 1,
            Encoding::Cdr => 2,
            Encoding::Ros1 => 3,
            Encoding::Other(code) => code,
        }
    }
}

impl From<u16> for Encoding {
    fn from(code: u16) -> Self {
        match code {
            0 => Self::Bytes,
            1 => Self::Json,
            2 => Self::Cdr,
            3 => Self::Ros1,
            code => Self::Other(code),
        }
    }
}

const PROOF_HEADER_LEN: usize = 4;

/// Plaintext bytes of a proof with a path of `depth` hashes.
pub const fn proof_len(depth: usize) -> usize {
    PROOF_HEADER_LEN + 32 * depth + SIGNATURE_LEN
}

fn is_proof_len(len: usize) -> bool {
    len >= proof_len(0) && len <= proof_len(MAX_DEPTH) && (len - proof_len(0)).is_multiple_of(32)
}

/// Where the message's leaf is in the signed tree, the way to the root, and the signature of the root.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Proof<'a> {
    pub position: u16,
    pub path: &'a [[u8; 32]],
    pub signature: &'a [u8; SIGNATURE_LEN],
}

impl<'a> Proof<'a> {
    /// Writes into `out`, which has [`proof_len`] bytes.
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

/// What a message is in the signed tree. `digests` are the SHA-256 of each body segment's ciphertext with its tag, in order.
pub fn leaf(backend: Backend, name: &Name, writer: &Name, header: &SegmentHeader, digests: &[[u8; 32]]) -> [u8; 32] {
    backend.sha256(&[
        &[0],
        MESSAGE_CONTEXT,
        name.as_bytes(),
        writer.as_bytes(),
        &header.session,
        &header.sequence.to_be_bytes(),
        &header.count.to_be_bytes(),
        &header.size.to_be_bytes(),
        digests.as_flattened(),
    ])
}

/// What is signed for the tree with this root.
pub fn batch_statement(root: &[u8; 32]) -> [u8; BATCH_CONTEXT.len() + 32] {
    let mut statement = [0u8; BATCH_CONTEXT.len() + 32];
    statement[..BATCH_CONTEXT.len()].copy_from_slice(BATCH_CONTEXT);
    statement[BATCH_CONTEXT.len()..].copy_from_slice(root);
    statement
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: SegmentHeader = SegmentHeader {
        proof: false,
        sealed_len: 116,
        index: 2,
        sequence: 0x0102_0304_0506_0708,
        session: [7; 16],
        count: 4,
        size: 100,
    };

    #[test]
    fn headers_round_trip_and_other_versions_are_unknown() {
        let bytes = HEADER.to_bytes();
        assert_eq!(SegmentHeader::parse(&bytes), Some(HEADER));
        for (at, value) in [(0, 0), (0, 2), (1, 2), (1, 0x81)] {
            let mut other = bytes;
            other[at] = value;
            assert_eq!(SegmentHeader::parse(&other), None, "byte {at} = {value}");
        }
    }

    #[test]
    fn only_headers_whose_fields_fit_each_other_have_a_length() {
        assert_eq!(HEADER.plaintext_len(), Some(100));
        assert_eq!(SegmentHeader { index: 3, sealed_len: 17, ..HEADER }.plaintext_len(), Some(1));
        let proof = SegmentHeader { proof: true, index: 4, sealed_len: 84, ..HEADER };
        assert_eq!(proof.plaintext_len(), Some(68));
        for (what, header) in [
            ("short segment in the middle", SegmentHeader { sealed_len: 115, ..HEADER }),
            ("long segment", SegmentHeader { index: 3, sealed_len: 117, ..HEADER }),
            ("empty last segment", SegmentHeader { index: 3, sealed_len: 16, ..HEADER }),
            ("no room for the tag", SegmentHeader { sealed_len: 15, ..HEADER }),
            ("index past the end", SegmentHeader { index: 4, ..HEADER }),
            ("largest index", SegmentHeader { index: u32::MAX, count: u32::MAX, ..HEADER }),
            ("no segments", SegmentHeader { index: 0, count: 0, ..HEADER }),
            ("size 0", SegmentHeader { size: 0, sealed_len: 16, ..HEADER }),
            ("size over 16 bits", SegmentHeader { index: 3, size: MAX_PLAINTEXT as u32 + 1, ..HEADER }),
            ("sequence 0", SegmentHeader { sequence: 0, ..HEADER }),
            ("proof before the end", SegmentHeader { index: 3, ..proof }),
            ("proof of another length", SegmentHeader { sealed_len: 85, ..proof }),
            ("proof with too long a path", SegmentHeader { sealed_len: 84 + 17 * 32, ..proof }),
        ] {
            assert_eq!(header.plaintext_len(), None, "{what}");
        }
    }

    #[test]
    fn proofs_round_trip_and_are_bounded() {
        let (path, signature) = ([[3; 32], [4; 32]], [5; 64]);
        let proof = Proof { position: 3, path: &path, signature: &signature };
        let mut bytes = vec![0; proof_len(2)];
        proof.write(&mut bytes);
        assert_eq!(Proof::parse(&bytes), Some(proof));
        for (at, value) in [(1, 4), (0, 1), (2, 1), (2, 3), (2, 255), (3, 1)] {
            let mut other = bytes.clone();
            other[at] = value;
            assert_eq!(Proof::parse(&other), None, "byte {at} = {value}");
        }
        assert!((0..bytes.len()).all(|len| Proof::parse(&bytes[..len]).is_none()));
    }

    #[test]
    fn extensions_of_later_versions_are_skipped() {
        let header = MessageHeader { timestamp_ns: 9, encoding: Encoding::Other(77), extensions_len: 3 };
        let mut plaintext = header.to_bytes().to_vec();
        plaintext.extend(b"extbody");
        assert_eq!(MessageHeader::parse(&plaintext), Some((header, 19)));
        assert_eq!(MessageHeader::parse(&plaintext[..18]), None);
        plaintext[15] = 1;
        assert_eq!(MessageHeader::parse(&plaintext), None, "reserved bytes");
    }
}
