//! Properties of whole runs, with random sequences of messages, new cuts, new keys, loss,
//! reordering, duplication, damage and forgeries by insiders. A delivered message was sealed by the
//! writer, is unmodified, and arrives once. Memory stays within the limits, and messages that
//! arrive completely are delivered.

use super::tests::{EPOCH, Fixture, at, limits};
use super::*;
use gdp_core::identity::SigningKey;
use gdp_core::keys::EpochKey;
use gdp_faults::Random;
use std::collections::{HashMap, HashSet};

#[test]
fn whatever_the_network_does_each_message_comes_unchanged_and_once() {
    for seed in 0..150 {
        let limits = ReaderLimits { max_memory_per_source: 60_000, max_memory: 60_000, ..limits() };
        let f = Fixture { limits, ..Fixture::new() };
        Run::new(&f, seed, u32::MAX).run(&f, 400);
    }
}

/// Without loss and memory limits, no message is missing, in any order and with any copies and
/// cuts.
#[test]
fn without_loss_nothing_is_missing() {
    for seed in 0..100 {
        let f = Fixture::new();
        // The reader retains the keys of four epochs, regardless of the frames in flight.
        let mut run = Run::new(&f, seed, EPOCH + 3);
        for _ in 0..40 {
            run.seal(&f);
        }
        run.random.shuffle(&mut run.network);
        while let Some(frame) = run.network.pop() {
            run.deliver(&f, &frame);
            if run.random.below(5) == 0 {
                run.deliver(&f, &frame);
            }
        }
        assert_eq!(run.delivered.len(), run.sealed.len(), "seed {seed}");
        assert_eq!(run.reader.memory(), 0);
    }
}

struct Run {
    random: Random,
    writer: Writer,
    reader: Reader,
    epoch: u32,
    last_epoch: u32,
    /// The sealed messages by sequence, with the number of new cuts.
    sealed: HashMap<u64, (Vec<u8>, u16)>,
    network: Vec<Vec<u8>>,
    delivered: HashSet<u64>,
    heartbeats: u64,
    now: u64,
}

impl Run {
    fn new(f: &Fixture, seed: u64, last_epoch: u32) -> Self {
        let (writer, mut reader) = (f.writer(), f.strict_reader());
        reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
        Self {
            random: Random::new(seed),
            writer,
            reader,
            epoch: EPOCH,
            last_epoch,
            sealed: HashMap::new(),
            network: vec![],
            delivered: HashSet::new(),
            heartbeats: 0,
            now: 0,
        }
    }

    fn run(&mut self, f: &Fixture, steps: usize) {
        for _ in 0..steps {
            match self.random.below(20) {
                0..4 => self.seal(f),
                4 => self.forge(f),
                5 => self.now += self.random.below(400_000_000),
                6 if !self.network.is_empty() => drop(self.take()),
                7 => {
                    let Some(mut frame) = self.take() else { continue };
                    let bit = self.random.below(frame.len() as u64 * 8) as usize;
                    frame[bit / 8] ^= 1 << (bit % 8);
                    self.deliver(f, &frame);
                }
                _ => {
                    let Some(frame) = self.take() else { continue };
                    if self.random.below(6) == 0 {
                        self.network.push(frame.clone());
                    }
                    self.deliver(f, &frame);
                }
            }
        }
        self.reader.expire(u64::MAX);
        assert_eq!(self.reader.memory(), 0);
        assert!(self.delivered.len() > 10);
    }

    /// Sends data of the writer to the network: a batch, a message with a new cut, or a heartbeat.
    /// Sometimes changes the key first.
    fn seal(&mut self, f: &Fixture) {
        let mut segments = Segments::new();
        let max_payload = 400 + self.random.below(1000) as usize;
        if self.random.below(10) == 0 && self.epoch < self.last_epoch {
            self.epoch += 1;
            let key = EpochKey::from_bytes([self.epoch as u8; 32]);
            self.writer.set_epoch(self.epoch, &key).unwrap();
            self.reader.set_key(&f.writer_name(), self.epoch, key).unwrap();
        }
        let again = 1 + self.random.below(self.writer.next_sequence());
        match (self.random.below(8), self.sealed.get_mut(&again)) {
            (0..2, Some((body, cut))) => {
                *cut += 1;
                let draft = Draft::new(Encoding::Bytes, body);
                self.writer.reseal(again, *cut, 0, draft, max_payload, &mut segments).unwrap();
            }
            (2, _) => self.writer.heartbeat(0, u64::MAX, 1, &mut segments).unwrap(),
            _ => {
                let bodies: Vec<_> = (0..1 + self.random.below(5))
                    .map(|_| {
                        let longest = [100, 100, 3000][self.random.below(3) as usize];
                        let len = self.random.below(longest) as usize;
                        self.random.bytes(len)
                    })
                    .collect();
                let drafts: Vec<_> = bodies.iter().map(|body| Draft::new(Encoding::Bytes, body)).collect();
                let first = self.writer.next_sequence();
                self.writer.seal_batch(0, &drafts, max_payload, &mut segments).unwrap();
                self.sealed.extend((first..).zip(bodies.into_iter().map(|body| (body, 0))));
            }
        }
        self.network.extend(segments.iter().map(<[u8]>::to_vec));
    }

    /// Forges data as another reader with the key: in the writer's session, at any sequence.
    fn forge(&mut self, f: &Fixture) {
        let mut forger = Writer::with_session(
            f.name,
            f.writer_name(),
            &SigningKey::from_secret_bytes(&[66; 32]).unwrap(),
            f.writing,
            self.writer.session(),
        )
        .unwrap();
        let key = if self.epoch == EPOCH { f.epoch_key.clone() } else { EpochKey::from_bytes([self.epoch as u8; 32]) };
        forger.set_epoch(self.epoch, &key).unwrap();
        let mut segments = Segments::new();
        let target = 1 + self.random.below(self.writer.next_sequence() + 10);
        let batch = vec![Draft::new(Encoding::Bytes, b"forged"); target as usize];
        forger.seal_batch(0, &batch, 1400, &mut segments).unwrap();
        let len = self.random.below(2000) as usize;
        let body = vec![0xee; len];
        forger.reseal(target, 1, 0, Draft::new(Encoding::Bytes, &body), 700, &mut segments).unwrap();
        self.network.extend(segments.iter().map(<[u8]>::to_vec));
        forger.heartbeat(0, u64::MAX, target, &mut segments).unwrap();
        self.network.extend(segments.iter().map(<[u8]>::to_vec));
    }

    fn take(&mut self) -> Option<Vec<u8>> {
        if self.network.is_empty() {
            return None;
        }
        let at = self.random.below(self.network.len().min(30) as u64) as usize;
        Some(self.network.remove(at))
    }

    fn deliver(&mut self, f: &Fixture, frame: &[u8]) {
        let mut out = Received::default();
        let _ = self.reader.push(at(self.now), f.writer_name(), frame, &mut out);
        assert!(self.reader.memory() <= f.limits.max_memory_per_source);
        for message in out.messages {
            let (body, _) = &self.sealed[&message.sequence];
            assert_eq!(message.body, body);
            assert_eq!(message.session, self.writer.session());
            assert!(self.delivered.insert(message.sequence), "message {} came twice", message.sequence);
        }
        for heartbeat in out.heartbeats {
            assert!(heartbeat.next >= self.heartbeats && heartbeat.next <= self.writer.next_sequence());
            self.heartbeats = heartbeat.next;
        }
    }
}
