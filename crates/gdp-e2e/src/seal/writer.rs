//! The writer of a session: message in, frame payloads out. Allocates nothing per frame, and
//! nothing per message once the buffers have grown.

use super::heartbeat::HeartbeatBody;
use super::merkle::{self, Tree};
use super::message::{Draft, Encoding, Preamble};
use super::plan::{Unit, plan};
use super::seal_error::SealError;
use super::segment::Segment;
use super::segments::Segments;
use super::used_cuts::UsedCuts;
use super::wire::{self, Kind, OVERHEAD, Proof, SegmentHeader};
use super::{DropReason, MAX_BATCH};
use gdp_core::crypto;
use gdp_core::crypto::{Backend, Signer, TAG_LEN};
use gdp_core::identity::SigningKey;
use gdp_core::keys::{EpochKey, SessionKey};
use gdp_core::name::Name;
use std::collections::VecDeque;
use std::fmt;

/// Number of previous epochs whose messages can be cut again.
const EPOCHS_KEPT: usize = 15;

/// Maximum number of segments under the key of a session and an epoch.
pub const MAX_SEGMENTS: u64 = 1 << 32;

/// One session of one writer of a name. Every `Writer` is a new session with a random identifier of
/// 128 bits. A restarted or second writer therefore never repeats a nonce under the same key. The
/// session continues across epochs.
pub struct Writer {
    name: Name,
    writer: Name,
    session: [u8; 16],
    epoch: Option<Epoch>,
    /// Previous epochs for messages that are cut again, the latest at the end.
    before: VecDeque<Epoch>,
    signer: Signer,
    backend: Backend,
    /// The sequence number of the next message; the first is 1.
    next: u64,
    used_cuts: UsedCuts,
    /// The number of the last heartbeat.
    heartbeats: u32,
    scratch: Scratch,
}

/// The key of an epoch, for sealing.
struct Epoch {
    number: u32,
    key: SessionKey,
    /// Number of sealed segments.
    used: u64,
}

/// Buffers that are reused for every message.
#[derive(Default)]
struct Scratch {
    units: Vec<Unit>,
    digests: Vec<[u8; 32]>,
    leaves: Vec<[u8; 32]>,
    pending: Vec<Pending>,
    tree: Tree,
    path: Vec<[u8; 32]>,
}

/// The parameters that messages sealed together share. Their sequences are consecutive.
struct SigningRun {
    epoch: u32,
    first: u64,
    cut: u16,
    timestamp_ns: u64,
}

/// A segment that is sealed when the root is signed. Its plaintext ends with room for the proof.
struct Pending {
    at: usize,
    header: SegmentHeader,
}

impl Writer {
    /// Creates a new session of `writer` (the entity that owns `key`) for messages to `name`.
    /// Sealing requires the key of an epoch first: [`Self::set_epoch`].
    pub fn new(name: Name, writer: Name, key: SigningKey, backend: Backend) -> Result<Self, SealError> {
        Self::with_session(name, writer, &key, backend, crypto::random()?)
    }

    /// For test vectors only: reusing a session identifier reveals the plaintext.
    pub(super) fn with_session(
        name: Name,
        writer: Name,
        key: &SigningKey,
        backend: Backend,
        session: [u8; 16],
    ) -> Result<Self, SealError> {
        let signer = key.signer(backend)?;
        let (used_cuts, scratch) = (UsedCuts::default(), Scratch::default());
        Ok(Self {
            name,
            writer,
            session,
            epoch: None,
            before: VecDeque::new(),
            signer,
            backend,
            next: 1,
            used_cuts,
            heartbeats: 0,
            scratch,
        })
    }

    /// Seals all further segments under this key. Epoch numbers only increase, so that no key is
    /// reused.
    pub fn set_epoch(&mut self, epoch: u32, key: &EpochKey) -> Result<(), SealError> {
        if let Some(Epoch { number: current, .. }) = self.epoch
            && epoch <= current
        {
            return Err(SealError::EpochGoesBack { epoch, current });
        }
        let key = key.session_key(self.backend, &self.name, &self.writer, &self.session)?;
        if self.before.len() == EPOCHS_KEPT {
            self.before.pop_front();
        }
        self.before.extend(self.epoch.replace(Epoch { number: epoch, key, used: 0 }));
        Ok(())
    }

    /// Returns the current epoch.
    pub fn epoch(&self) -> Option<u32> {
        self.epoch.as_ref().map(|epoch| epoch.number)
    }

    pub fn name(&self) -> Name {
        self.name
    }

    pub fn session(&self) -> [u8; 16] {
        self.session
    }

    /// Returns the sequence number of the next message.
    pub fn next_sequence(&self) -> u64 {
        self.next
    }

    /// Seals one message into frame payloads of at most `max_payload` bytes. Replaces the contents
    /// of `out`; after an error `out` is empty.
    pub fn seal(
        &mut self,
        now_unix_ns: u64,
        encoding: Encoding,
        body: &[u8],
        max_payload: usize,
        out: &mut Segments,
    ) -> Result<(), SealError> {
        self.seal_batch(now_unix_ns, &[Draft::new(encoding, body)], max_payload, out)
    }

    /// Seals several messages under one signature; small ones share frames.
    pub fn seal_batch(
        &mut self,
        now_unix_ns: u64,
        messages: &[Draft<'_>],
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
        let first = self.next;
        let next = first + messages.len() as u64;
        if next > wire::MAX_SEQUENCE {
            return Err(SealError::SequenceExhausted);
        }
        let epoch = self.spend(messages, max_payload)?;
        // Advanced before sealing, so that no nonce is reused after a failure below.
        self.next = next;
        let run = SigningRun { epoch, first, cut: 0, timestamp_ns: now_unix_ns };
        self.seal_run(run, messages, max_payload, out).inspect_err(|_| out.clear())
    }

    /// Seals a message of this session again, for another frame size or under a newer key.
    /// `message` and `timestamp_ns` must be those of the first time. `cut` must be higher than all
    /// previous cuts; the first is 0. Readers deliver the cut that is complete first.
    pub fn reseal(
        &mut self,
        sequence: u64,
        cut: u16,
        timestamp_ns: u64,
        message: Draft<'_>,
        max_payload: usize,
        out: &mut Segments,
    ) -> Result<(), SealError> {
        out.clear();
        let refused = |why| SealError::Cut { sequence, cut, why };
        if sequence == 0 || sequence >= self.next {
            return Err(refused("this session has not sealed it yet"));
        }
        let messages = [message];
        let epoch = self.spend(&messages, max_payload)?;
        self.used_cuts.take(sequence, cut).map_err(refused)?;
        let run = SigningRun { epoch, first: sequence, cut, timestamp_ns };
        self.seal_run(run, &messages, max_payload, out).inspect_err(|_| out.clear())
    }

    /// Seals segments of the last 16 epochs of this session again, for another payload size.
    /// `sealed` contains all segments of whole messages, concatenated. Equivalent to
    /// [`Self::reseal`] for each message, except that the messages of a bundle are signed together.
    pub fn recut(&mut self, sealed: &[u8], cut: u16, max_payload: usize, out: &mut Segments) -> Result<(), SealError> {
        out.clear();
        self.recut_into(sealed, cut, max_payload, out).inspect_err(|_| out.clear())
    }

    fn recut_into(&mut self, sealed: &[u8], cut: u16, max_payload: usize, out: &mut Segments) -> Result<(), SealError> {
        let (mut rest, mut plaintext) = (sealed, Vec::new());
        while let Ok((segment, behind)) = Segment::split(rest) {
            rest = behind;
            let SegmentHeader { kind, sequence, count, .. } = segment.header;
            let refused = |why| SealError::Cut { sequence, cut, why };
            let foreign = |_| refused("it is none of this session");
            let mut epochs = self.epoch.iter().chain(&self.before);
            let epoch = epochs.find(|epoch| epoch.number == segment.header.epoch);
            let epoch = epoch.ok_or(refused("the key it was sealed under is gone"))?;
            let at = plaintext.len();
            plaintext.resize(at + segment.plaintext_len, 0);
            segment.open(&epoch.key.aead, &mut plaintext[at..]).map_err(foreign)?;
            if kind == Kind::Body {
                continue;
            }
            let (part, _) = Proof::split(&plaintext[at..]).ok_or(DropReason::BadMessage).map_err(foreign)?;
            plaintext.truncate(at + part.len());
            let messages = match kind {
                Kind::Bundle => Preamble::parse_bundle(&plaintext, count).map_err(foreign)?,
                _ => vec![Preamble::parse(&plaintext).map_err(foreign)?],
            };
            let timestamp_ns = messages.first().map_or(0, |message| message.timestamp_ns);
            let drafts: Vec<_> = messages.iter().map(|message| message.draft(&plaintext)).collect();
            let epoch = self.spend(&drafts, max_payload)?;
            for sequence in (sequence..).take(drafts.len()) {
                self.used_cuts.take(sequence, cut).map_err(refused)?;
            }
            let run = SigningRun { epoch, first: sequence, cut, timestamp_ns };
            self.seal_run(run, &drafts, max_payload, out)?;
            plaintext.clear();
        }
        Ok(())
    }

    /// Seals a heartbeat: all messages before `next` were sent, and those before `oldest` are no
    /// longer available. For readers that may have missed the last messages. A heartbeat is one
    /// segment, small enough for any link, and costs a signature.
    pub fn heartbeat(&mut self, now_unix_ns: u64, next: u64, oldest: u64, out: &mut Segments) -> Result<(), SealError> {
        out.clear();
        let next = next.clamp(1, self.next);
        let epoch = self.spend_segments(1)?;
        // One epoch has fewer heartbeats, but a session has many epochs.
        self.heartbeats = self.heartbeats.checked_add(1).ok_or(SealError::SequenceExhausted)?;
        let header = SegmentHeader::heartbeat(self.session, self.heartbeats, next, epoch);
        let body = HeartbeatBody { timestamp_ns: now_unix_ns, oldest };
        let signature = self.signer.sign(&body.statement(&self.name, &self.writer, &header))?;
        let mut plaintext = body.to_bytes(&signature);
        let clear = header.to_bytes();
        let tag = self.key()?.aead.seal(&header.nonce(), &clear, &mut plaintext)?;
        out.begin(wire::HEADER_LEN + usize::from(header.sealed_len), usize::MAX);
        [&clear[..], &plaintext, &tag].iter().for_each(|part| out.buffer().extend_from_slice(part));
        Ok(())
    }

    /// Plans the segments of the messages, and counts them towards the limit. Returns the epoch.
    fn spend(&mut self, messages: &[Draft<'_>], max_payload: usize) -> Result<u32, SealError> {
        plan(messages, max_payload, &mut self.scratch.units)?;
        let segments = self.scratch.units.iter().map(|unit| u64::from(unit.segments)).sum();
        self.spend_segments(segments)
    }

    fn spend_segments(&mut self, segments: u64) -> Result<u32, SealError> {
        let epoch = self.epoch.as_mut().ok_or(SealError::NoEpoch)?;
        if epoch.used + segments > MAX_SEGMENTS {
            return Err(SealError::EpochExhausted(epoch.number));
        }
        epoch.used += segments;
        Ok(epoch.number)
    }

    fn key(&self) -> Result<&SessionKey, SealError> {
        self.epoch.as_ref().map(|epoch| &epoch.key).ok_or(SealError::NoEpoch)
    }

    /// Seals the messages as planned.
    fn seal_run(
        &mut self,
        run: SigningRun,
        messages: &[Draft<'_>],
        max_payload: usize,
        out: &mut Segments,
    ) -> Result<(), SealError> {
        let units = std::mem::take(&mut self.scratch.units);
        let result = self.seal_units(&run, &units, messages, max_payload, out);
        self.scratch.units = units;
        result
    }

    fn seal_units(
        &mut self,
        run: &SigningRun,
        units: &[Unit],
        messages: &[Draft<'_>],
        max_payload: usize,
        out: &mut Segments,
    ) -> Result<(), SealError> {
        let proof_len = wire::proof_len(merkle::depth(units.len()));
        self.scratch.leaves.clear();
        self.scratch.pending.clear();
        let (mut sequence, mut rest) = (run.first, messages);
        for unit in units {
            let (of_unit, behind) = rest.split_at(unit.messages);
            let is_bundle = unit.messages > 1;
            let header = SegmentHeader {
                kind: if is_bundle { Kind::Bundle } else { Kind::Body },
                sealed_len: 0,
                index: 0,
                sequence,
                cut: run.cut,
                session: self.session,
                count: if is_bundle { unit.messages as u32 } else { unit.segments },
                size: unit.size,
                epoch: run.epoch,
            };
            (sequence, rest) = (sequence + unit.messages as u64, behind);
            self.scratch.digests.clear();
            match of_unit {
                [message] => {
                    let preamble = &message.preamble(run.timestamp_ns)[..message.preamble_len()];
                    self.seal_body(header, preamble, message.body, (proof_len, max_payload), out)?;
                }
                bundled => {
                    let fill = |buffer: &mut Vec<u8>| {
                        buffer.extend_from_slice(&run.timestamp_ns.to_be_bytes());
                        bundled.iter().for_each(|message| message.bundle_into(buffer));
                    };
                    self.prepare(header, unit.size as usize, fill, (proof_len, max_payload), out);
                }
            }
            let (commitment, place) = (&self.key()?.commitment, (&self.name, &self.writer));
            let leaf = wire::leaf(commitment, place, &header, &self.scratch.digests);
            self.scratch.leaves.push(leaf);
        }
        self.seal_pending(out)
    }

    /// Seals the segments of one message, and prepares the last one. Leaves the digests of their
    /// plaintexts in the scratch buffers.
    fn seal_body(
        &mut self,
        mut header: SegmentHeader,
        preamble: &[u8],
        body: &[u8],
        (proof_len, max_payload): (usize, usize),
        out: &mut Segments,
    ) -> Result<(), SealError> {
        let (mut head, mut rest) = (preamble, body);
        let (last, capacity) = (header.count - 1, header.size as usize);
        for index in 0..last {
            // If the end of the message leaves no room for the proof, the last segment is empty.
            let from_head = split_off_front(&mut head, capacity);
            let from_body = split_off_front(&mut rest, capacity - from_head.len());
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
            self.scratch.digests.push(crypto::sha256(&[&buffer[sealed..]]));
            let tag = self.key()?.aead.seal(&header.nonce(), &clear, &mut buffer[sealed..])?;
            buffer.extend_from_slice(&tag);
        }
        header.kind = Kind::Last;
        header.index = last;
        let fill = |buffer: &mut Vec<u8>| {
            buffer.extend_from_slice(head);
            buffer.extend_from_slice(rest);
        };
        self.prepare(header, head.len() + rest.len(), fill, (proof_len, max_payload), out);
        Ok(())
    }

    /// Appends a segment that ends with a proof, except for the proof. `fill` appends its `len`
    /// bytes of plaintext.
    fn prepare(
        &mut self,
        header: SegmentHeader,
        len: usize,
        fill: impl FnOnce(&mut Vec<u8>),
        (proof_len, max_payload): (usize, usize),
        out: &mut Segments,
    ) {
        let header = SegmentHeader { sealed_len: (len + proof_len + TAG_LEN) as u16, ..header };
        let at = out.begin(len + proof_len + OVERHEAD, max_payload);
        let buffer = out.buffer();
        buffer.extend_from_slice(&header.to_bytes());
        fill(buffer);
        self.scratch.digests.push(crypto::sha256(&[&buffer[at + wire::HEADER_LEN..]]));
        buffer.resize(at + len + proof_len + OVERHEAD, 0);
        self.scratch.pending.push(Pending { at, header });
    }

    /// Signs the tree of the leaves, and seals the prepared segments with their proofs.
    fn seal_pending(&mut self, out: &mut Segments) -> Result<(), SealError> {
        let Scratch { leaves, pending, tree, path, .. } = &mut self.scratch;
        tree.build(leaves);
        let signature = self.signer.sign(&wire::batch_statement(&tree.root()))?;
        let aead = self.epoch.as_ref().map(|epoch| &epoch.key.aead).ok_or(SealError::NoEpoch)?;
        for (position, Pending { at, header }) in pending.iter().enumerate() {
            tree.path(position, path);
            let segment = &mut out.buffer()[*at..][..wire::HEADER_LEN + usize::from(header.sealed_len)];
            let (clear, sealed) = segment.split_at_mut(wire::HEADER_LEN);
            let (plaintext, tag_place) = sealed.split_at_mut(usize::from(header.sealed_len) - TAG_LEN);
            let proof_at = plaintext.len() - wire::proof_len(path.len());
            Proof { position: position as u16, path, signature: &signature }.write(&mut plaintext[proof_at..]);
            tag_place.copy_from_slice(&aead.seal(&header.nonce(), clear, plaintext)?);
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

#[cfg(test)]
#[path = "../../tests/unit/seal/writer.rs"]
mod tests;
