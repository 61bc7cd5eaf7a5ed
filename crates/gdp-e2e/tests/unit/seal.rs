//! The cases that must work: any message, any order, both back ends, batches, new and old sessions.
//! `hostile_tests` contains the cases that must fail.

use super::wire::{OVERHEAD, proof_len};
use super::*;
use gdp_core::crypto::Backend;
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::EpochKey;
use gdp_core::name::Name;
use gdp_faults::Random;
use std::cell::Cell;

#[test]
fn messages_of_any_size_cross_between_all_back_ends() {
    for &writing in Backend::ALL {
        for &reading in Backend::ALL {
            let f = Fixture { writing, reading, ..Fixture::new() };
            let (mut writer, mut reader) = (f.writer(), f.reader());
            let mut segments = Segments::new();
            for (i, len) in [0, 1, 64, 1196, 1197, 1324, 1325, 5_000, 100_000].into_iter().enumerate() {
                let body = Random::new(len as u64 + 1).bytes(len);
                writer.seal(1000 + i as u64, Encoding::Cdr, &body, 1400, &mut segments).unwrap();
                assert!(segments.iter().all(|payload| payload.len() <= 1400));
                let message = only(push_all(&mut reader, f.writer_name(), segments.iter()));
                assert_eq!(message.body, body);
                assert_eq!((message.sequence, message.timestamp_ns), (i as u64 + 1, 1000 + i as u64));
                assert_eq!((message.name, message.writer), (f.name, f.writer_name()));
                assert_eq!((message.session, message.encoding), (writer.session(), Encoding::Cdr));
            }
            assert_eq!(reader.memory(), 0);
            assert_eq!(reader.drops(), &[0; DropReason::COUNT]);
        }
    }
}

#[test]
fn a_small_message_is_one_frame_and_a_full_tail_shares_one_with_the_proof() {
    let f = Fixture::new();
    let mut writer = f.writer();
    let mut segments = Segments::new();
    writer.seal(0, Encoding::Bytes, &[0; 64], 1400, &mut segments).unwrap();
    assert_eq!(segments.len(), 1);
    assert_eq!(segments.total_bytes(), 12 + 64 + MIN_PAYLOAD);
    // One full segment, and a last segment that shares its payload with the proof.
    writer.seal(0, Encoding::Bytes, &[0; 1340 - 12 + 100], 1400, &mut segments).unwrap();
    assert_eq!(segments.iter().map(<[u8]>::len).collect::<Vec<_>>(), [1400, 100 + MIN_PAYLOAD]);
    // A last segment that leaves no room for the proof.
    writer.seal(0, Encoding::Bytes, &[0; 2 * 1340 - 12], 1400, &mut segments).unwrap();
    assert_eq!(segments.iter().map(<[u8]>::len).collect::<Vec<_>>(), [1400, 1400, MIN_PAYLOAD]);
    // The buffer is replaced, not extended.
    writer.seal(0, Encoding::Bytes, b"", 1400, &mut segments).unwrap();
    assert_eq!(segments.len(), 1);
}

#[test]
fn order_does_not_matter_and_duplicates_do_no_harm() {
    for seed in 1..50 {
        let f = Fixture::new();
        let mut random = Random::new(seed);
        let (mut writer, mut reader) = (f.writer(), f.reader());
        let mut frames = Vec::new();
        let mut bodies = Vec::new();
        for _ in 0..5 {
            let len = random.below(6000) as usize;
            bodies.push(random.bytes(len));
            frames.extend(f.seal(&mut writer, bodies.last().unwrap(), 300));
        }
        let copies: Vec<_> = frames.iter().filter(|_| random.below(3) == 0).cloned().collect();
        let duplicates = copies.len();
        frames.extend(copies);
        random.shuffle(&mut frames);
        let (mut messages, mut refused) = (Received::default(), 0);
        for frame in &frames {
            match reader.push(at(0), f.writer_name(), frame, &mut messages) {
                Ok(()) => {}
                Err(DropReason::Duplicate) => refused += 1,
                Err(other) => panic!("{other}"),
            }
        }
        let mut messages = messages.messages;
        messages.sort_by_key(|message| message.sequence);
        assert_eq!(messages.iter().map(|message| &message.body[..]).collect::<Vec<_>>(), bodies, "seed {seed}");
        assert_eq!(refused, duplicates);
        assert_eq!(reader.memory(), 0);
    }
}

#[test]
fn a_batch_has_one_signature_and_each_message_stands_alone() {
    let f = Fixture::new();
    for count in [1, 2, 3, 5, 8, 40] {
        let bodies: Vec<Vec<u8>> = (0..count).map(|i| vec![i as u8; 50 * i]).collect();
        let items: Vec<_> = bodies.iter().map(|body| Draft::new(Encoding::Json, body)).collect();
        let mut segments = Segments::new();
        f.writer().seal_batch(5, &items, 1400, &mut segments).unwrap();
        assert!(segments.iter().all(|payload| payload.len() <= 1400));
        let mut reader = f.reader();
        let messages = push_all(&mut reader, f.writer_name(), segments.iter());
        assert_eq!(messages.iter().map(|message| &message.body[..]).collect::<Vec<_>>(), bodies);

        // The messages in the other frames verify without the first frame.
        let mut reader = f.reader();
        let rest = push_all(&mut reader, f.writer_name(), segments.iter().skip(1));
        assert_eq!(rest, messages[messages.len() - rest.len()..]);
    }
    let mut segments = Segments::new();
    f.writer().seal_batch(5, &[], 1400, &mut segments).unwrap();
    assert!(segments.is_empty());
}

#[test]
fn small_messages_of_a_batch_share_frames() {
    let f = Fixture::new();
    let mut segments = Segments::new();
    f.writer().seal_batch(0, &[Draft::new(Encoding::Bytes, &[1; 10]); 8], 1400, &mut segments).unwrap();
    // One segment for all: a timestamp, 6 + 10 bytes each, and a proof.
    assert_eq!((segments.len(), segments.segments().count()), (1, 1));
    assert_eq!(segments.total_bytes(), OVERHEAD + 8 + 8 * (6 + 10) + proof_len(0));
    let f = Fixture::new();
    // Sixteen are more than a bundle has room for. Two bundles are a tree of two leaves.
    let bodies = [[7; 100]; 16];
    let drafts = bodies.each_ref().map(|body| Draft::new(Encoding::Bytes, body));
    f.writer().seal_batch(0, &drafts, 1400, &mut segments).unwrap();
    let bundled = segments.segments().map(|(id, bytes)| (id.sequence, id.last(), bytes.len())).collect::<Vec<_>>();
    let len = |messages: usize| OVERHEAD + 8 + messages * (6 + 100) + proof_len(1);
    assert_eq!(bundled, [(1, 11, len(11)), (12, 16, len(5))]);
    // Each stands alone.
    let mut reader = f.reader();
    let second = segments.iter().skip(1);
    assert_eq!(push_all(&mut reader, f.writer_name(), second).len(), 5);
    assert_eq!(push_all(&mut reader, f.writer_name(), segments.iter().take(1)).len(), 11);
    assert_eq!(reader.memory(), 0);
}

#[test]
fn a_restarted_writer_is_a_new_session_and_both_are_read() {
    let f = Fixture::new();
    let (mut first, mut second) = (f.writer(), f.writer());
    assert_ne!(first.session(), second.session());
    let mut reader = f.reader();
    for writer in [&mut first, &mut second] {
        let frames = f.seal(writer, b"hello", 1400);
        assert_eq!(only(push_all(&mut reader, f.writer_name(), &frames)).sequence, 1);
    }
    // Two sealings of the same plaintext differ.
    assert_ne!(f.seal(&mut first, b"x", 1400)[0][44..60], f.seal(&mut second, b"x", 1400)[0][44..60]);
}

#[test]
fn what_misses_its_deadline_is_dropped_whole_and_newer_messages_pass() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let slow = f.seal(&mut writer, &[1; 5000], 1400);
    let quick = f.seal(&mut writer, b"quick", 1400);
    let mut messages = Received::default();
    reader.push(at(0), f.writer_name(), &slow[0], &mut messages).unwrap();
    assert_eq!(reader.next_deadline(), Some(DEADLINE));
    reader.push(at(1), f.writer_name(), &quick[0], &mut messages).unwrap();
    assert_eq!(only(std::mem::take(&mut messages.messages)).body, "quick");

    assert_eq!(reader.expire(DEADLINE), 0);
    assert_eq!(reader.expire(DEADLINE + 1), 1);
    assert_eq!((reader.memory(), reader.next_deadline()), (0, None));
    assert_eq!(reader.drops()[DropReason::Deadline as usize], 1);
    // The remaining segments do not complete the message, and `push` expires it without a call of
    // `expire`.
    for frame in &slow[1..] {
        reader.push(at(DEADLINE + 2), f.writer_name(), frame, &mut messages).unwrap();
    }
    assert!(messages.messages.is_empty());
    let frames = f.seal(&mut writer, b"later", 1400);
    reader.push(at(10 * DEADLINE), f.writer_name(), &frames[0], &mut messages).unwrap();
    assert_eq!(reader.drops()[DropReason::Deadline as usize], 2);
    assert_eq!(messages.messages.len(), 1);
}

#[test]
fn when_memory_is_short_the_writers_own_oldest_message_gives_way() {
    let f = Fixture { limits: ReaderLimits { max_memory_per_source: 40_000, ..limits() }, ..Fixture::new() };
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let messages: Vec<_> = (0..3).map(|_| f.seal(&mut writer, &[1; 15_000], 1400)).collect();
    let mut out = Received::default();
    for (now, frames) in messages.iter().enumerate() {
        reader.push(at(now as u64), f.writer_name(), &frames[0], &mut out).unwrap();
        assert!(reader.memory() <= 40_000);
    }
    assert_eq!(reader.drops()[DropReason::Evicted as usize], 1);
    // The oldest message does not return at the cost of newer ones, which complete.
    assert_eq!(reader.push(at(9), f.writer_name(), &messages[0][1], &mut out), Err(DropReason::MemoryFull));
    for frame in messages[1][1..].iter().chain(&messages[2][1..]) {
        reader.push(at(9), f.writer_name(), frame, &mut out).unwrap();
    }
    assert_eq!(out.messages.iter().map(|message| message.sequence).collect::<Vec<_>>(), [2, 3]);
    assert_eq!(reader.memory(), 0);
}

#[test]
fn one_writer_cannot_use_up_another_ones_memory() {
    let limits = ReaderLimits { max_memory: 50_000, max_memory_per_source: 30_000, ..limits() };
    let f = Fixture { limits, ..Fixture::new() };
    let mut reader = f.reader();
    let mut out = Received::default();
    let mut other = f.writer_of(&f.other);
    f.introduce(&mut reader, &f.other);
    f.confirm_session(&mut reader, &f.other);
    let honest = f.seal(&mut other, &[2; 10_000], 1400);
    reader.push(at(0), f.other.name(), &honest[0], &mut out).unwrap();
    let mut greedy = f.writer();
    for _ in 0..100 {
        let frames = f.seal(&mut greedy, &[1; 15_000], 1400);
        reader.push(at(0), f.writer_name(), &frames[0], &mut out).unwrap();
    }
    assert!(reader.memory() <= 50_000);
    push_into(&mut reader, f.other.name(), &honest[1..], &mut out);
    assert_eq!(only(out.messages).writer, f.other.name());
}

#[test]
fn revoking_a_writer_silences_it_and_frees_its_memory() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let frames = f.seal(&mut writer, &[1; 5000], 1400);
    let mut out = Received::default();
    reader.push(at(0), f.writer_name(), &frames[0], &mut out).unwrap();
    assert!(reader.memory() > 5000);
    reader.revoke(&f.writer_name());
    assert_eq!(reader.memory(), 0);
    assert_eq!(reader.push(at(0), f.writer_name(), &frames[1], &mut out), Err(DropReason::UnknownWriter));
    assert_eq!(reader.writers().count(), 0);
}

pub const DEADLINE: u64 = 1_000_000_000;

/// The epoch of the fixture's key.
pub const EPOCH: u32 = 5;

/// Returns a time that is the same on both clocks.
pub fn at(ns: u64) -> Timestamps {
    Timestamps { steady_ns: ns, unix_ns: ns }
}

pub fn limits() -> ReaderLimits {
    ReaderLimits {
        max_message: 200_000,
        max_memory_per_source: 1 << 20,
        max_memory: 4 << 20,
        ..ReaderLimits::default()
    }
}

/// One name, two entities that may write it, and configurable readers and writers.
pub struct Fixture {
    pub name: Name,
    pub entity: Identity,
    pub other: Identity,
    pub epoch_key: EpochKey,
    pub writing: Backend,
    pub reading: Backend,
    pub limits: ReaderLimits,
    /// Number of writers created so far.
    pub begun: Cell<u8>,
}

impl Fixture {
    pub fn new() -> Self {
        Self {
            name: Name::from_bytes([0x11; 32]),
            entity: Identity::new(SigningKey::from_secret_bytes(&[1; 32]).unwrap(), "proxy"),
            other: Identity::new(SigningKey::from_secret_bytes(&[2; 32]).unwrap(), "proxy"),
            epoch_key: EpochKey::from_bytes([0x22; 32]),
            writing: Backend::selected(),
            reading: Backend::selected(),
            limits: limits(),
            begun: Cell::new(0),
        }
    }

    pub fn writer_name(&self) -> Name {
        self.entity.name()
    }

    pub fn writer(&self) -> Writer {
        self.writer_of(&self.entity)
    }

    pub fn writer_of(&self, entity: &Identity) -> Writer {
        self.begun.set(self.begun.get() + 1);
        let session = Self::session(self.begun.get());
        self.with_epoch(Writer::with_session(self.name, entity.name(), entity.key(), self.writing, session).unwrap())
    }

    /// Returns the session of the `n`th writer.
    fn session(n: u8) -> [u8; 16] {
        [n; 16]
    }

    /// Returns a writer in the entity's name, with a given session and any signing key.
    pub fn writer_in(&self, session: [u8; 16], key: &SigningKey) -> Writer {
        self.with_epoch(Writer::with_session(self.name, self.writer_name(), key, self.writing, session).unwrap())
    }

    fn with_epoch(&self, mut writer: Writer) -> Writer {
        writer.set_epoch(EPOCH, &self.epoch_key).unwrap();
        writer
    }

    /// Returns a reader with the entity, its key, and the confirmed sessions of the first writers.
    pub fn reader(&self) -> Reader {
        let mut reader = self.strict_reader();
        self.confirm_session(&mut reader, &self.entity);
        reader
    }

    /// Confirms the sessions of the first writers of the entity.
    pub fn confirm_session(&self, reader: &mut Reader, entity: &Identity) {
        for n in 1..=self.limits.max_sessions as u8 {
            reader.confirm_session(&entity.name(), Self::session(n), 0).unwrap();
        }
    }

    /// Returns a reader without confirmed sessions.
    pub fn strict_reader(&self) -> Reader {
        let mut reader = Reader::new(self.name, self.reading, self.limits);
        self.introduce(&mut reader, &self.entity);
        reader
    }

    pub fn introduce(&self, reader: &mut Reader, entity: &Identity) {
        reader.authorise(entity.name(), entity.key().verify_key()).unwrap();
        reader.set_key(&entity.name(), EPOCH, self.epoch_key.clone()).unwrap();
    }

    /// Returns the frame payloads of one message, with its sequence as its timestamp.
    pub fn seal(&self, writer: &mut Writer, body: &[u8], max_payload: usize) -> Vec<Vec<u8>> {
        let mut segments = Segments::new();
        writer.seal(writer.next_sequence(), Encoding::Bytes, body, max_payload, &mut segments).unwrap();
        segments.iter().map(<[u8]>::to_vec).collect()
    }
}

pub fn push_all(reader: &mut Reader, source: Name, frames: impl IntoIterator<Item: AsRef<[u8]>>) -> Vec<Message> {
    let mut out = Received::default();
    push_into(reader, source, frames, &mut out);
    out.messages
}

pub fn push_into(reader: &mut Reader, source: Name, frames: impl IntoIterator<Item: AsRef<[u8]>>, out: &mut Received) {
    for frame in frames {
        reader.push(at(0), source, frame.as_ref(), out).unwrap();
    }
}

pub fn only(mut messages: Vec<Message>) -> Message {
    assert_eq!(messages.len(), 1, "{messages:?}");
    messages.remove(0)
}
