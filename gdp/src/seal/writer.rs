//! The writing end of a session: message in, frame payloads out. Nothing is allocated per frame, and once the buffers
//! have grown, nothing per message.

use super::merkle::{self, Tree};
use super::segments::Segments;
use super::wire::{self, Encoding, MESSAGE_HEADER_LEN, MessageHeader, OVERHEAD, Proof, SegmentHeader};
use super::{EpochKey, MAX_BATCH};
use crate::crypto::{self, Aead, Backend, CryptoError, Signer, TAG_LEN};
use crate::identity::SigningKey;
use crate::name::Name;
use std::fmt;

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SealError {
    #[error("frame payloads of {max_payload} bytes are too small: {need} are needed; raise the link's MTU")]
    PayloadTooSmall { max_payload: usize, need: usize },
    #[error("a message of {len} bytes needs more than 2^32 segments of {size} bytes")]
    MessageTooLarge { len: usize, size: usize },
    #[error("a batch of {0} messages where at most {MAX_BATCH} may share a signature")]
    BatchTooLarge(usize),
    #[error("this session has used all its sequence numbers; start a new one")]
    SequenceExhausted,
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}

/// One session of one writer of a name. Every `Writer` is a new session under a random identifier of 128 bits, so a
/// restarted or a second writer never seals twice under one key and nonce.
pub struct Writer {
    name: Name,
    writer: Name,
    session: [u8; 16],
    aead: Aead,
    signer: Signer,
    backend: Backend,
    /// The sequence number of the next message; they begin at 1.
    next: u64,
    scratch: Scratch,
}

/// Buffers that keep their capacity from message to message.
#[derive(Default)]
struct Scratch {
    digests: Vec<[u8; 32]>,
    leaves: Vec<[u8; 32]>,
    pending: Vec<PendingProof>,
    tree: Tree,
    path: Vec<[u8; 32]>,
}

/// A proof segment whose place is reserved, to be filled in when the root is signed.
struct PendingProof {
    at: usize,
    header: SegmentHeader,
}

impl Writer {
    /// A new session of `writer` (the entity that `key` belongs to) for messages to `name`.
    pub fn new(
        name: Name,
        writer: Name,
        epoch_key: &EpochKey,
        key: SigningKey,
        backend: Backend,
    ) -> Result<Self, SealError> {
        Self::with_session(name, writer, epoch_key, &key, backend, crypto::random()?)
    }

    /// For test vectors only: a session identifier that is used twice gives the plaintext away.
    pub(super) fn with_session(
        name: Name,
        writer: Name,
        epoch_key: &EpochKey,
        key: &SigningKey,
        backend: Backend,
        session: [u8; 16],
    ) -> Result<Self, SealError> {
        let aead = epoch_key.session_aead(backend, &name, &writer, &session)?;
        let signer = key.signer(backend)?;
        Ok(Self { name, writer, session, aead, signer, backend, next: 1, scratch: Scratch::default() })
    }

    pub fn name(&self) -> Name {
        self.name
    }

    pub fn session(&self) -> [u8; 16] {
        self.session
    }

    /// The sequence number that the next message gets.
    pub fn next_sequence(&self) -> u64 {
        self.next
    }

    /// Seals one message into `out`, whose former content is dropped: frame payloads of at most `max_payload` bytes.
    /// After an error `out` is empty.
    pub fn seal(
        &mut self,
        now_unix_ns: u64,
        encoding: Encoding,
        body: &[u8],
        max_payload: usize,
        out: &mut Segments,
    ) -> Result<(), SealError> {
        self.seal_batch(now_unix_ns, &[(encoding, body)], max_payload, out)
    }

    /// Seals several messages under one signature; small ones share frames.
    pub fn seal_batch(
        &mut self,
        now_unix_ns: u64,
        messages: &[(Encoding, &[u8])],
        max_payload: usize,
        out: &mut Segments,
    ) -> Result<(), SealError> {
        out.clear();
        if messages.is_empty() {
            return Ok(());
        }
        if messages.len() > MAX_BATCH {
            return Err(SealError::BatchTooLarge(messages.len()));
        }
        let depth = merkle::depth(messages.len());
        for (_, body) in messages {
            Cut::new(body.len(), max_payload, depth)?;
        }
        let first = self.next;
        // Taken before anything is sealed: whatever fails below, no nonce is used again.
        self.next = first.checked_add(messages.len() as u64).ok_or(SealError::SequenceExhausted)?;
        let result = self.seal_from(first, now_unix_ns, messages, max_payload, depth, out);
        if result.is_err() {
            out.clear();
        }
        result
    }

    fn seal_from(
        &mut self,
        first: u64,
        timestamp_ns: u64,
        messages: &[(Encoding, &[u8])],
        max_payload: usize,
        depth: usize,
        out: &mut Segments,
    ) -> Result<(), SealError> {
        self.scratch.leaves.clear();
        self.scratch.pending.clear();
        for (sequence, &(encoding, body)) in (first..self.next).zip(messages) {
            let cut = Cut::new(body.len(), max_payload, depth)?;
            let header = SegmentHeader {
                proof: false,
                sealed_len: 0,
                index: 0,
                sequence,
                session: self.session,
                count: cut.count,
                size: cut.size,
            };
            let message_header = MessageHeader { timestamp_ns, encoding, extensions_len: 0 };
            self.seal_body(header, &message_header.to_bytes(), body, max_payload, out)?;
            self.scratch.leaves.push(wire::leaf(
                self.backend,
                &self.name,
                &self.writer,
                &header,
                &self.scratch.digests,
            ));
            self.reserve_proof(header, depth, max_payload, out);
        }
        self.seal_proofs(out)
    }

    /// The body segments of one message; leaves their digests in the scratch.
    fn seal_body(
        &mut self,
        mut header: SegmentHeader,
        message_header: &[u8; MESSAGE_HEADER_LEN],
        body: &[u8],
        max_payload: usize,
        out: &mut Segments,
    ) -> Result<(), SealError> {
        self.scratch.digests.clear();
        let (mut head, mut rest) = (message_header.as_slice(), body);
        for index in 0..header.count {
            let from_head = split_off_front(&mut head, header.size as usize);
            let from_body = split_off_front(&mut rest, header.size as usize - from_head.len());
            let len = from_head.len() + from_body.len();
            header.index = index;
            header.sealed_len = (len + TAG_LEN) as u16;
            let clear = header.to_bytes();

            let at = out.begin(len + OVERHEAD, max_payload);
            let buffer = out.buffer();
            buffer.extend_from_slice(&clear);
            buffer.extend_from_slice(from_head);
            buffer.extend_from_slice(from_body);
            let sealed = at + wire::HEADER_LEN;
            let tag = self.aead.seal(&header.nonce(), &clear, &mut buffer[sealed..])?;
            buffer.extend_from_slice(&tag);
            self.scratch.digests.push(self.backend.sha256(&[&buffer[sealed..]]));
        }
        Ok(())
    }

    fn reserve_proof(&mut self, header: SegmentHeader, depth: usize, max_payload: usize, out: &mut Segments) {
        let len = wire::proof_len(depth);
        let header = SegmentHeader { proof: true, index: header.count, sealed_len: (len + TAG_LEN) as u16, ..header };
        let at = out.begin(len + OVERHEAD, max_payload);
        out.buffer().resize(at + len + OVERHEAD, 0);
        self.scratch.pending.push(PendingProof { at, header });
    }

    fn seal_proofs(&mut self, out: &mut Segments) -> Result<(), SealError> {
        let Scratch { leaves, pending, tree, path, .. } = &mut self.scratch;
        tree.build(self.backend, leaves);
        let signature = self.signer.sign(&wire::batch_statement(&tree.root()))?;
        for (position, PendingProof { at, header }) in pending.iter().enumerate() {
            tree.path(position, path);
            let clear = header.to_bytes();
            let segment = &mut out.buffer()[*at..][..wire::HEADER_LEN + usize::from(header.sealed_len)];
            let (clear_place, sealed) = segment.split_at_mut(wire::HEADER_LEN);
            let (plaintext, tag_place) = sealed.split_at_mut(wire::proof_len(path.len()));
            clear_place.copy_from_slice(&clear);
            Proof { position: position as u16, path, signature: &signature }.write(plaintext);
            tag_place.copy_from_slice(&self.aead.seal(&header.nonce(), &clear, plaintext)?);
        }
        Ok(())
    }
}

impl fmt::Debug for Writer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, writer, next, .. } = self;
        write!(
            f,
            "Writer {{ name: {name:#}, writer: {writer:#}, session: {}, next: {next} }}",
            hex::encode(self.session)
        )
    }
}

fn split_off_front<'a>(data: &mut &'a [u8], most: usize) -> &'a [u8] {
    let (front, rest) = data.split_at(most.min(data.len()));
    *data = rest;
    front
}

/// How a message is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cut {
    count: u32,
    size: u32,
}

impl Cut {
    fn new(body_len: usize, max_payload: usize, depth: usize) -> Result<Self, SealError> {
        let need = OVERHEAD + wire::proof_len(depth);
        if max_payload < need {
            return Err(SealError::PayloadTooSmall { max_payload, need });
        }
        let capacity = (max_payload - OVERHEAD).min(wire::MAX_PLAINTEXT);
        let too_large = SealError::MessageTooLarge { len: body_len, size: capacity };
        let len = body_len.checked_add(MESSAGE_HEADER_LEN).ok_or(too_large)?;
        let size = capacity.min(len);
        let count = u32::try_from(len.div_ceil(size)).map_err(|_| too_large)?;
        Ok(Self { count, size: size as u32 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_cut_into_the_fewest_segments() {
        let cap = 1000 - OVERHEAD;
        let cut = |len, max| Cut::new(len, max, 0);
        assert_eq!(cut(0, 1000), Ok(Cut { count: 1, size: 16 }));
        assert_eq!(cut(cap - 16, 1000), Ok(Cut { count: 1, size: cap as u32 }));
        assert_eq!(cut(cap - 15, 1000), Ok(Cut { count: 2, size: cap as u32 }));
        assert_eq!(cut(10 * cap - 16, 1000), Ok(Cut { count: 10, size: cap as u32 }));
        assert_eq!(cut(100, wire::MIN_PAYLOAD), Ok(Cut { count: 2, size: 68 }));
        assert_eq!(cut(1 << 20, usize::MAX), Ok(Cut { count: 17, size: 65519 }));
    }

    #[test]
    fn what_cannot_be_cut_is_refused() {
        let small = |max_payload, need| Err(SealError::PayloadTooSmall { max_payload, need });
        assert_eq!(Cut::new(1, wire::MIN_PAYLOAD - 1, 0), small(123, 124));
        assert_eq!(Cut::new(1, 0, 0), small(0, 124));
        assert_eq!(Cut::new(1, 200, 16), small(200, 636));
        assert!(matches!(Cut::new(usize::MAX, 1000, 0), Err(SealError::MessageTooLarge { .. })));
        let most = (u32::MAX as usize) * 68;
        assert_eq!(Cut::new(most - 16, wire::MIN_PAYLOAD, 0), Ok(Cut { count: u32::MAX, size: 68 }));
        assert!(matches!(Cut::new(most - 15, wire::MIN_PAYLOAD, 0), Err(SealError::MessageTooLarge { .. })));
    }

    #[test]
    fn a_session_ends_before_its_sequence_wraps() {
        let key = SigningKey::for_test(1);
        let name = Name::from_bytes([1; 32]);
        let mut writer = Writer::new(name, name, &EpochKey::from_bytes([1; 32]), key, Backend::default()).unwrap();
        let mut out = Segments::new();
        writer.next = u64::MAX - 1;
        writer.seal(0, Encoding::Bytes, b"last", 1000, &mut out).unwrap();
        assert_eq!(writer.seal(0, Encoding::Bytes, b"x", 1000, &mut out), Err(SealError::SequenceExhausted));
        assert!(out.is_empty());
    }
}
