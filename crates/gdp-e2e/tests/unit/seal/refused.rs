//! Messages that a reader must refuse, for the published vectors: composed as the document says,
//! but for one thing.

use super::wire::{self, VERSION};
use super::*;
use gdp_core::crypto::{self, Backend};
use gdp_core::identity::SigningKey;
use gdp_core::keys::EpochKey;
use gdp_core::name::Name;

/// The message "hello" of one segment in the scene of the vectors.
pub struct Composition<'a> {
    /// The first byte of the header.
    pub version: u8,
    /// The second byte of the header.
    pub kind: u8,
    pub extensions: &'a [u8],
    pub epoch: u32,
    /// Each byte of the writer's secret key.
    pub signer: u8,
    /// Each byte of the name and of the session that it is sealed for.
    pub name: u8,
    pub session: u8,
    pub sequence: u64,
    /// Added to the number of segments in the header.
    pub more_segments: u32,
    /// Added to the size of the message in the header.
    pub more_bytes: u32,
}

impl Default for Composition<'_> {
    fn default() -> Self {
        Self {
            version: VERSION,
            kind: 1,
            extensions: &[],
            epoch: 1_700_000_000,
            signer: 1,
            name: 0x11,
            session: 0x44,
            sequence: 1,
            more_segments: 0,
            more_bytes: 0,
        }
    }
}

impl Composition<'_> {
    /// Composes the payload as the document says.
    pub fn payload(&self) -> Vec<u8> {
        let (name, writer) = (Name::from_bytes([self.name; 32]), Name::from_bytes([0x22; 32]));
        let key = SigningKey::from_secret_bytes(&[self.signer; 32]).unwrap();
        let id = [self.session; 16];
        let session = EpochKey::from_bytes([0x33; 32]).session_key(Backend::RustCrypto, &name, &writer, &id).unwrap();
        let length = (self.extensions.len() as u16).to_be_bytes();
        let part = [&1_700_000_000_123_456_789u64.to_be_bytes()[..], &[0, 2], &length, self.extensions, b"hello"];
        let part = part.concat();
        let header = wire::SegmentHeader {
            kind: wire::Kind::Last,
            sealed_len: (part.len() + wire::proof_len(0) + 16) as u16,
            index: 0,
            sequence: self.sequence,
            cut: 0,
            session: id,
            count: 1 + self.more_segments,
            size: part.len() as u32 + self.more_bytes,
            epoch: self.epoch,
        };
        let digest = crypto::sha256(&[&part]);
        let root = wire::leaf(&session.commitment, (&name, &writer), &header, &[digest]);
        let signature = key.signer(Backend::RustCrypto).unwrap().sign(&wire::batch_statement(&root)).unwrap();
        let mut sealed = [&part[..], &signature, &[0; 4]].concat();
        let mut clear = header.to_bytes();
        (clear[0], clear[1]) = (self.version, self.kind);
        let tag = session.aead.seal(&header.nonce(), &clear, &mut sealed).unwrap();
        [&clear[..], &sealed, &tag].concat()
    }
}

/// Returns payloads that a reader pushes one after the other, of which it refuses the last.
pub fn cases() -> Vec<(&'static str, DropReason, Vec<Vec<u8>>)> {
    let good = Composition::default().payload();
    let one = |composition: Composition<'_>| vec![composition.payload()];
    let of = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut payload = good.clone();
        change(&mut payload);
        vec![payload]
    };
    vec![
        ("a payload that ends within the header", DropReason::Truncated, of(&|payload| payload.truncate(43))),
        ("a payload that ends within the tag", DropReason::Truncated, of(&|payload| payload.truncate(120))),
        ("a changed byte of the header", DropReason::Forged, of(&|payload| payload[13] ^= 2)),
        ("a changed byte of the ciphertext", DropReason::Forged, of(&|payload| payload[50] ^= 1)),
        ("a changed tag", DropReason::Forged, of(&|payload| *payload.last_mut().unwrap() ^= 1)),
        (
            "a message sealed for another name",
            DropReason::Forged,
            one(Composition { name: 0x12, ..Default::default() }),
        ),
        (
            "the signature of another key",
            DropReason::BadSignature,
            one(Composition { signer: 2, ..Default::default() }),
        ),
        (
            "a session that the writer did not confirm",
            DropReason::Unvouched,
            one(Composition { session: 0x45, ..Default::default() }),
        ),
        (
            "an epoch whose key the reader does not have",
            DropReason::NoKey,
            one(Composition { epoch: 1_700_000_001, ..Default::default() }),
        ),
        ("sequence 0", DropReason::BadHeader, one(Composition { sequence: 0, ..Default::default() })),
        (
            "a header with more bytes than the segment",
            DropReason::BadHeader,
            one(Composition { more_bytes: 1, ..Default::default() }),
        ),
        (
            "the last segment with index 0 of two",
            DropReason::BadHeader,
            one(Composition { more_segments: 1, ..Default::default() }),
        ),
        ("the same message again", DropReason::Duplicate, vec![good.clone(), good.clone()]),
    ]
}
