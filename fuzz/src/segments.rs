//! Payloads of data frames, through a reader.
//!
//! The input is a few steps: a byte that says which, two of length, and that many bytes; until
//! there is nothing left. Nobody guesses a key, so there is a step that seals what it is given, as
//! another reader of the name could, and one that has the true writer send something.

use std::collections::HashMap;
use std::time::Duration;

use gdp_core::crypto::{self, Aead, Backend, TAG_LEN};
use gdp_core::identity::Identity;
use gdp_core::keys::EpochKey;
use gdp_e2e::seal::{
    Draft, Encoding, MIN_PAYLOAD, MessageId, Reader, ReaderLimits, Received, SegmentId, Segments, Timestamps, Writer,
};
use gdp_wire::Name;

/// Steps of an input that are looked at.
const MAX_STEPS: usize = 64;

const HEADER: usize = 44;
const EPOCH: u32 = 1;
const KEY: [u8; 32] = [3; 32];
const NAME: Name = Name::from_bytes([1; 32]);
const DEADLINE: Duration = Duration::from_millis(100);

/// The kinds of steps; what is higher is one of them again.
pub const PAYLOAD: u8 = 0;
pub const INSIDER: u8 = 1;
pub const WRITER: u8 = 2;
pub const ARRIVE: u8 = 3;
pub const TIME: u8 = 4;
pub const VOUCH: u8 = 5;
pub const EPOCHS: u8 = 6;
const KINDS: u8 = 7;

/// Whatever comes, memory stays within the limits, and what is delivered was sent by the writer, is
/// unchanged and comes once.
pub fn segments(data: &[u8]) {
    let mut scene = Scene::new();
    for (kind, bytes) in steps(data) {
        match kind % KINDS {
            PAYLOAD => scene.push(bytes),
            INSIDER => scene.push(&scene.sealed(bytes)),
            WRITER => scene.send(bytes),
            ARRIVE => scene.arrive(bytes),
            TIME => scene.wait(bytes),
            VOUCH => scene.confirm_session(bytes),
            _ => scene.change_epoch(bytes),
        }
    }
    scene.reader.expire(u64::MAX);
    assert_eq!((scene.reader.memory(), scene.reader.next_deadline()), (0, None));
}

fn steps(mut data: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let next = move || {
        let ([kind, high, low], rest) = data.split_first_chunk()?;
        let (bytes, behind) = rest.split_at(usize::from(u16::from_be_bytes([*high, *low])).min(rest.len()));
        data = behind;
        Some((*kind, bytes))
    };
    std::iter::from_fn(next).take(MAX_STEPS)
}

struct Scene {
    writer: Writer,
    entity: Identity,
    epoch: u32,
    reader: Reader,
    limits: ReaderLimits,
    now: Timestamps,
    /// What the writer has sealed, by sequence, and under how many cuts.
    sent: HashMap<u64, (Vec<u8>, u16)>,
    delivered: Vec<u64>,
    next_heard: u64,
    /// Payloads on their way.
    network: Vec<Vec<u8>>,
}

impl Scene {
    fn new() -> Self {
        let entity = Identity::generate("proxy").expect("an identity");
        let (name, key) = (entity.name(), entity.key().clone());
        let mut writer = Writer::new(NAME, name, key, Backend::selected()).expect("a writer");
        writer.set_epoch(EPOCH, &EpochKey::from_bytes(KEY)).expect("the first epoch");
        let limits = ReaderLimits {
            max_message: 4000,
            max_memory_per_source: 20_000,
            max_memory: 30_000,
            deadline: DEADLINE,
            max_sessions: 3,
            ..ReaderLimits::default()
        };
        let mut reader = Reader::new(NAME, Backend::selected(), limits);
        reader.authorise(name, entity.key().verify_key()).expect("a key");
        reader.set_key(&name, EPOCH, EpochKey::from_bytes(KEY)).expect("an authorised writer");
        reader.confirm_session(&name, writer.session(), 1).expect("an authorised writer");
        let (now, sent, delivered, network) = (Timestamps::default(), HashMap::new(), Vec::new(), Vec::new());
        Self { writer, entity, epoch: EPOCH, reader, limits, now, sent, delivered, next_heard: 0, network }
    }

    /// A payload arrives.
    fn push(&mut self, payload: &[u8]) {
        let mut received = Received::default();
        let result = self.reader.push(self.now, self.entity.name(), payload, &mut received);
        assert!(self.reader.memory() <= self.limits.max_memory_per_source, "{} bytes", self.reader.memory());
        assert_eq!(self.reader.next_deadline().is_some(), self.reader.memory() > 0);
        if let Err(reason) = result {
            assert!(self.reader.drops()[reason as usize] > 0);
        }
        for message in received.messages {
            let (body, _) = self.sent.get(&message.sequence).expect("only what was sent");
            assert_eq!(message.session, self.writer.session());
            assert_eq!(message.body, body);
            assert!(!self.delivered.contains(&message.sequence), "message {} came twice", message.sequence);
            self.delivered.push(message.sequence);
        }
        for heartbeat in received.heartbeats {
            assert!(heartbeat.next >= self.next_heard && heartbeat.next <= self.writer.next_sequence());
            self.next_heard = heartbeat.next;
        }
        let present: usize = received.segments.iter().map(|segment: &SegmentId| segment.len).sum();
        assert!(present <= payload.len());
    }

    /// Headers, each with the plaintext behind it in the place of the ciphertext, sealed by
    /// somebody who has the key. What says session 0 is of the writer's.
    fn sealed(&self, bytes: &[u8]) -> Vec<u8> {
        let mut payload = Vec::new();
        let mut rest = bytes;
        while let Some((clear, behind)) = rest.split_first_chunk::<HEADER>() {
            let mut clear = *clear;
            if clear[16..32] == [0; 16] {
                clear[16..32].copy_from_slice(&self.writer.session());
            }
            let length = usize::from(u16::from_be_bytes([clear[2], clear[3]])).saturating_sub(TAG_LEN);
            let (plaintext, behind) = behind.split_at(length.min(behind.len()));
            rest = behind;
            let mut nonce = [0; 12];
            nonce[..8].copy_from_slice(&clear[8..16]);
            nonce[8..].copy_from_slice(&clear[4..8]);
            let mut sealed = plaintext.to_vec();
            let tag = self.aead(clear[16..32].try_into().expect("16 bytes")).seal(&nonce, &clear, &mut sealed);
            payload.extend([&clear[..], &sealed, &tag.expect("a tag")].concat());
        }
        payload
    }

    fn aead(&self, session: &[u8; 16]) -> Aead {
        let writer = self.entity.name();
        let info: [&[u8]; 3] = [b"gdp/session/1", NAME.as_bytes(), writer.as_bytes()];
        let key = crypto::hkdf_sha256(session, &KEY, &info).expect("a key");
        Backend::selected().aead(&key).expect("a cipher")
    }

    /// The writer seals something; all of it is on its way then. The bytes: what, how large
    /// payloads are, and a body.
    fn send(&mut self, bytes: &[u8]) {
        let &[what, size, ref body @ ..] = bytes else { return };
        let max_payload = MIN_PAYLOAD + 3 * 32 + 4 * usize::from(size);
        let mut segments = Segments::new();
        let last = self.writer.next_sequence() - 1;
        match (what % 4, self.sent.get_mut(&last)) {
            (0, _) => {
                let result = self.writer.heartbeat(self.now.unix_ns, last + 1, last, &mut segments);
                result.expect("a heartbeat");
            }
            (1, Some((body, cut))) => {
                *cut += 1;
                let draft = Draft::new(Encoding::Bytes, body);
                let result = self.writer.reseal(last, *cut, self.now.unix_ns, draft, max_payload, &mut segments);
                result.expect("another cut");
            }
            _ => {
                let request = MessageId { session: [what; 16], sequence: size.into() };
                let drafts = body.chunks(usize::from(what) * 4 + 1).take(8).map(|body| Draft {
                    in_reply_to: (what & 4 == 0).then_some(request),
                    origin: &body[..body.len().min(9)],
                    service: (what & 8 == 0).then_some(Name::from_bytes([what; 32])),
                    ..Draft::new(Encoding::Cdr, body)
                });
                let drafts: Vec<_> = drafts.collect();
                let result = self.writer.seal_batch(self.now.unix_ns, &drafts, max_payload, &mut segments);
                result.expect("a batch");
                self.sent.extend((last + 1..).zip(drafts.iter().map(|draft| (draft.body.to_vec(), 0))));
            }
        }
        self.network.extend(segments.iter().map(<[u8]>::to_vec));
    }

    /// One payload on its way arrives: which, by the first byte; it stays there for an odd second;
    /// a third and fourth damage it.
    fn arrive(&mut self, bytes: &[u8]) {
        let &[which, again, ref damage @ ..] = bytes else { return };
        if self.network.is_empty() {
            return;
        }
        let at = usize::from(which) % self.network.len();
        let mut payload = self.network[at].clone();
        if again % 2 == 0 {
            self.network.swap_remove(at);
        }
        if let &[high, low, flip, ..] = damage {
            let at = usize::from(u16::from_be_bytes([high, low])) % payload.len();
            payload[at] ^= flip;
        }
        self.push(&payload);
    }

    fn wait(&mut self, bytes: &[u8]) {
        let milliseconds = bytes.iter().map(|byte| u64::from(*byte)).sum::<u64>();
        self.now.steady_ns += milliseconds * 1_000_000;
        self.now.unix_ns += milliseconds * 1_000_000;
        if bytes.len().is_multiple_of(2) {
            self.reader.expire(self.now.steady_ns);
        }
    }

    /// For another session, or for the writer's again. No number of others displaces it but by
    /// being vouched for, so it is vouched for last.
    fn confirm_session(&mut self, bytes: &[u8]) {
        let Some((session, rest)) = bytes.split_first_chunk::<16>() else { return };
        let writer = self.entity.name();
        self.reader.confirm_session(&writer, *session, rest.len() as u64).expect("an authorised writer");
        self.reader
            .confirm_session(&writer, self.writer.session(), 1 + rest.len() as u64)
            .expect("an authorised writer");
    }

    /// The writer begins another epoch, and the reader gets its key; or loses one.
    fn change_epoch(&mut self, bytes: &[u8]) {
        let &[what, ..] = bytes else { return };
        if what % 2 == 0 {
            return self.reader.drop_key(&self.entity.name(), u32::from(what / 2));
        }
        self.epoch += 1;
        self.writer.set_epoch(self.epoch, &EpochKey::from_bytes(KEY)).expect("a later epoch");
        let result = self.reader.set_key(&self.entity.name(), self.epoch, EpochKey::from_bytes(KEY));
        result.expect("an authorised writer");
    }
}
