//! A name that this node publishes: its [sealer](super::sealer) and its known readers.
//!
//! The receiving thread answers readers; the supervisor adds new ones.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::Notify;

use super::ending::{Ended, Ending};
use super::error::{NodeError, Unflushed};
use super::options::{PublishOptions, Reliability};
use super::pairs::Pairs;
use super::scheduler::Scheduler;
use super::sealer::Sealer;
use gdp_core::cert::Revocation;
use gdp_core::crypto::PUBLIC_KEY_LEN;
use gdp_core::identity::Identity;
use gdp_e2e::feedback_wire::{Feedback, Wants};
use gdp_e2e::transport::{TopicCounters, TopicId};
use gdp_proto::peers::{Counterpart, PeerEvent};

/// Time for which a detached reader retains its state and keys, because links return. In
/// nanoseconds.
const ABSENCE: u64 = 60_000_000_000;

/// Minimum interval between transmissions of latched messages to all readers, independent of the
/// number of new readers. In nanoseconds.
const BETWEEN_LATCHES: u64 = 1_000_000_000;

/// Maximum number of detached readers with state. Beyond it, the reader with the longest absence
/// loses its state.
const MOST_ABSENT: usize = 64;

pub struct Publication {
    pub name: Name,
    pub sealer: Sealer,
    /// Number of messages that are retained for retransmission; 0: best effort.
    history: u32,
    /// Notified when a waiting publisher should check again: space is available, or waiting is
    /// pointless.
    pub room: Notify,
    /// Serialises the tasks that store key boxes.
    pub boxing: tokio::sync::Mutex<()>,
    scheduler: Arc<Scheduler>,
    pairs: Arc<Pairs>,
    readers: Mutex<Readers>,
    pub ending: Arc<Ending>,
    last_counters: OnceLock<TopicCounters>,
}

#[derive(Default)]
struct Readers {
    known: HashMap<Name, KnownReader>,
    revocation: Option<Revocation>,
    /// Whether a reader was welcomed since the last transmission of latched messages, and the time
    /// of that transmission.
    lacks_latched: bool,
    latched_at: Option<u64>,
    /// Whether the log has reported a reader that requests more than the publication offers.
    has_warned: bool,
}

struct KnownReader {
    right: Counterpart,
    /// The sequence number that the Welcome announces as the start.
    from: u64,
    /// The last challenge that was answered.
    greeted: Option<[u8; 16]>,
    /// The session of its feedback with the last Hello. It has another one after a restart.
    pair_session: Option<[u8; 8]>,
    /// The time since when the reader is detached.
    absent: Option<u64>,
    wants: Wants,
}

impl Readers {
    fn attached(&self) -> impl Iterator<Item = (&Name, &KnownReader)> {
        self.known.iter().filter(|(_, reader)| reader.absent.is_none())
    }

    /// Returns whether an attached reader requests every message, or has not stated its request
    /// yet.
    fn asks_for_all(&self, reader: &Name) -> bool {
        let asks = |reader: &KnownReader| {
            reader.absent.is_none() && (reader.wants != Wants::Newest || reader.greeted.is_none())
        };
        self.known.get(reader).is_some_and(asks)
    }
}

impl Publication {
    pub fn new(
        name: Name,
        identity: &Identity,
        options: &PublishOptions,
        scheduler: &Arc<Scheduler>,
        pairs: &Arc<Pairs>,
    ) -> Result<Self, NodeError> {
        let ending = Arc::default();
        Ok(Self {
            name,
            sealer: Sealer::new(name, identity, options, scheduler, &ending)?,
            history: match options.reliability {
                Reliability::Reliable { .. } => u32::try_from(options.history.max(1)).unwrap_or(u32::MAX),
                Reliability::BestEffort { .. } => 0,
            },
            room: Notify::new(),
            boxing: tokio::sync::Mutex::default(),
            scheduler: scheduler.clone(),
            pairs: pairs.clone(),
            readers: Mutex::default(),
            ending,
            last_counters: OnceLock::new(),
        })
    }

    pub fn topic(&self) -> TopicId {
        self.sealer.topic
    }

    /// Ends sending.
    pub fn end(&self, why: Ended) {
        self.ending.end(why);
        self.room.notify_waiters();
    }

    /// Returns the number of attached readers.
    pub fn readers(&self) -> usize {
        self.readers.lock().attached().count()
    }

    /// Returns the number of attached readers that request every message from a best-effort
    /// publication.
    pub fn incompatible_readers(&self) -> usize {
        if self.is_reliable() {
            0
        } else {
            self.readers.lock().attached().filter(|(_, reader)| reader.wants == Wants::Every).count()
        }
    }

    /// Returns the number of unsent messages, and for each reader the number of unacknowledged
    /// ones.
    pub fn unfinished(&self) -> Unflushed {
        let readers = self.readers.lock();
        let waiting = self.sealer.waiting();
        let (unsent, lacking) = self.scheduler.uplink().unfinished(self.topic()).unwrap_or_default();
        let lacking = lacking.into_iter().filter(|(reader, _)| self.is_reliable() && readers.asks_for_all(reader));
        Unflushed { unsent: unsent + waiting, unacknowledged: lacking.collect() }
    }

    /// Sends the latched messages again if a new reader lacks them.
    pub fn latch(&self) {
        let now = self.scheduler.clock.now();
        {
            let readers = &mut *self.readers.lock();
            let soon = readers.latched_at.is_some_and(|last| now.saturating_sub(last) < BETWEEN_LATCHES);
            if !readers.lacks_latched || soon {
                return;
            }
            (readers.lacks_latched, readers.latched_at) = (false, Some(now));
        }
        self.sealer.send_latched();
    }

    pub fn is_reliable(&self) -> bool {
        self.history > 0
    }

    /// Answers a reader's Hello with the session. `pair_session` is that of the reader's feedback.
    pub fn welcome(&self, reader: &Name, pair_session: [u8; 8], challenge: [u8; 16], wants: Wants) -> Option<Feedback> {
        let readers = &mut *self.readers.lock();
        let entry = readers.known.get_mut(reader)?;
        entry.wants = wants;
        if wants == Wants::Every && !self.is_reliable() && !std::mem::replace(&mut readers.has_warned, true) {
            tracing::warn!(name = %self.name, %reader, "incompatible QoS: the reader asks for every message, and \
                                                        this writer offers the newest only (best effort); it takes \
                                                        those");
        }
        if entry.greeted != Some(challenge) {
            readers.lacks_latched = true;
            // A reader that asks again has lost its state or doubts it. It starts with the next
            // message.
            if entry.greeted.replace(challenge).is_some() {
                entry.from = self.admit(*reader)?;
            }
            if entry.pair_session.replace(pair_session).is_some_and(|before| before != pair_session) {
                self.scheduler.uplink().restart(self.scheduler.clock.now(), self.topic(), reader, entry.from);
            }
        }
        let (name, session, sequence) = (self.name, self.sealer.session, entry.from);
        Some(Feedback::Welcome { name, challenge, session, sequence, history: self.history })
    }

    /// Returns the answer to a reader's question for the time of this writer, if it is a reader and
    /// the question is about the current session.
    pub fn clock_answer(&self, reader: &Name, session: [u8; 16], challenge: [u8; 16]) -> Option<Feedback> {
        let is_reader = self.readers.lock().known.contains_key(reader);
        let (name, unix_ns) = (self.name, self.scheduler.stamp());
        (is_reader && session == self.sealer.session).then_some(Feedback::ClockAnswer { name, challenge, unix_ns })
    }

    /// Processes the return of a detached reader. If the reader has restarted, it receives messages
    /// from now on, also those sent before its Hello.
    pub fn returned(&self, reader: &Name) {
        let readers = &mut *self.readers.lock();
        let Some(entry) = readers.known.get_mut(reader) else { return };
        if let Some(from) = self.admit(*reader) {
            (entry.from, entry.greeted) = (from, None);
        }
    }

    /// Processes the verified updates of the RIB about readers.
    pub fn take(&self, now_unix: u64, events: impl IntoIterator<Item = PeerEvent>) {
        let readers = &mut *self.readers.lock();
        for event in events {
            match event {
                PeerEvent::Joined(right) => self.join(readers, right),
                PeerEvent::Left(reader) => {
                    if let Some(entry) = readers.known.get_mut(&reader) {
                        entry.absent = entry.absent.or(Some(self.scheduler.clock.now()));
                    }
                }
                PeerEvent::Expelled(reader) => {
                    readers.known.get_mut(&reader).into_iter().for_each(|entry| entry.right.not_after = 0);
                }
                PeerEvent::Revoked(revocation) => readers.revocation = Some(revocation),
                PeerEvent::Refused(error) => {
                    tracing::warn!(name = %self.name, %error, "the RIB told of a reader that does not verify");
                }
                // Key boxes are for readers. The supervisor handles a RIB that lacks a revocation.
                PeerEvent::KeyBox(_) | PeerEvent::RibIsBehind(_) => {}
            }
        }
        self.sweep(readers, now_unix);
    }

    /// Removes readers whose right has ended, or that are detached for too long.
    pub fn expire(&self, now_unix: u64) {
        self.sweep(&mut self.readers.lock(), now_unix);
    }

    fn join(&self, readers: &mut Readers, right: Counterpart) {
        let (entity, box_key) = (right.entity, right.box_key);
        if let Some(entry) = readers.known.get_mut(&entity) {
            if entry.right.box_key != box_key {
                self.pairs.introduce(entity, box_key);
                self.pairs.part(&entity);
            }
            (entry.right, entry.absent) = (right, None);
            return;
        }
        self.pairs.introduce(entity, box_key);
        // Readers beyond the transport's capacity share the transmissions to the other readers.
        let from = self.admit(entity).unwrap_or(1);
        readers.known.insert(
            entity,
            KnownReader { right, from, greeted: None, pair_session: None, absent: None, wants: Wants::Newest },
        );
    }

    /// Returns the sequence number that the reader starts with, if the transport tracks the reader.
    fn admit(&self, reader: Name) -> Option<u64> {
        self.scheduler.uplink().join(self.scheduler.clock.now(), self.topic(), reader)
    }

    fn sweep(&self, readers: &mut Readers, now_unix: u64) {
        let now = self.scheduler.clock.now();
        let Readers { known, revocation, .. } = readers;
        let too_many = known.values().filter(|reader| reader.absent.is_some()).count().saturating_sub(MOST_ABSENT);
        let mut away: Vec<_> = known.iter().filter_map(|(name, reader)| Some((reader.absent?, *name))).collect();
        away.sort_unstable();
        let holds = |reader: &KnownReader| {
            reader.right.not_after >= now_unix && revocation.as_ref().is_none_or(|r| reader.right.holds(r))
        };
        let longest = away.iter().take(too_many).map(|(_, name)| *name);
        let ended = known.iter().filter(|(_, reader)| {
            !holds(reader) || reader.absent.is_some_and(|since| now.saturating_sub(since) > ABSENCE)
        });
        let gone: Vec<Name> = ended.map(|(name, _)| *name).chain(longest).collect();
        for reader in gone.into_iter().filter(|reader| known.remove(reader).is_some()) {
            self.scheduler.uplink().leave(now, self.topic(), &reader);
            self.pairs.part(&reader);
        }
        let readers: Vec<(Name, [u8; PUBLIC_KEY_LEN])> =
            known.iter().map(|(name, reader)| (*name, reader.right.box_key)).collect();
        for (reader, why) in self.sealer.set_readers(&readers) {
            tracing::warn!(name = %self.name, %reader, "it gets no keys: {why}");
        }
    }

    /// Returns the counters of messages and frames, also after the publication is closed.
    pub fn counters(&self) -> TopicCounters {
        let now = self.scheduler.uplink().counters(self.topic());
        now.or_else(|| self.last_counters.get().copied()).unwrap_or_default()
    }

    /// Closes the publication.
    pub fn close(&self) {
        {
            let mut uplink = self.scheduler.uplink();
            uplink.counters(self.topic()).map(|last| self.last_counters.set(last));
            uplink.close(self.topic());
        }
        self.ending.end(Ended::Closed);
        let readers = std::mem::take(&mut self.readers.lock().known);
        readers.keys().for_each(|reader| self.pairs.part(reader));
    }
}
