//! A name that this node publishes: its [sealer](super::sealer), and its readers as far as they are
//! known here. The receiving thread answers readers, the supervisor brings new ones.

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

/// A reader that is not attached any more keeps its place and its keys for so long: links come
/// back.
const ABSENCE: u64 = 60_000_000_000;

/// Latched messages go to all readers again when one comes; however many come, not more often.
const BETWEEN_LATCHES: u64 = 1_000_000_000;

/// Readers that are absent and keep their places; of more, the one longest away loses it.
const MOST_ABSENT: usize = 64;

pub struct Publication {
    pub name: Name,
    pub sealer: Sealer,
    pub is_reliable: bool,
    /// There is room again for a publisher that waits, or no sense in waiting: it is to look.
    pub room: Notify,
    /// Boxes are handed out by one task at a time.
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
    /// One was welcomed since the latched messages went again, and when that was.
    lacks_latched: bool,
    latched_at: Option<u64>,
    /// The log has told of a reader that asks for more than is offered.
    has_warned: bool,
}

struct KnownReader {
    right: Counterpart,
    /// What it is told to begin with.
    from: u64,
    /// The challenge that was answered last.
    greeted: Option<[u8; 16]>,
    /// Since when it is not attached.
    absent: Option<u64>,
    wants: Wants,
}

impl Readers {
    fn attached(&self) -> impl Iterator<Item = (&Name, &KnownReader)> {
        self.known.iter().filter(|(_, reader)| reader.absent.is_none())
    }

    /// Whether one is attached that asks for every message, as far as it has said.
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
            is_reliable: matches!(options.reliability, Reliability::Reliable { .. }),
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

    /// Nothing is sent any more.
    pub fn end(&self, why: Ended) {
        self.ending.end(why);
        self.room.notify_waiters();
    }

    /// Readers that are attached.
    pub fn readers(&self) -> usize {
        self.readers.lock().attached().count()
    }

    /// Those of them that ask for every message, where the newest is offered.
    pub fn incompatible_readers(&self) -> usize {
        if self.is_reliable {
            0
        } else {
            self.readers.lock().attached().filter(|(_, reader)| reader.wants == Wants::Every).count()
        }
    }

    /// What has not gone yet, and what of it whom has not reached.
    pub fn unfinished(&self) -> Unflushed {
        let readers = self.readers.lock();
        let waiting = self.sealer.waiting();
        let (unsent, lacking) = self.scheduler.uplink().unfinished(self.topic()).unwrap_or_default();
        let lacking = lacking.into_iter().filter(|(reader, _)| self.is_reliable && readers.asks_for_all(reader));
        Unflushed { unsent: unsent + waiting, unacknowledged: lacking.collect() }
    }

    /// Sends the latched messages again, if a reader has come that lacks them.
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

    /// Answers a reader that asks which session this is.
    pub fn welcome(&self, reader: &Name, challenge: [u8; 16], wants: Wants) -> Option<Feedback> {
        let readers = &mut *self.readers.lock();
        let entry = readers.known.get_mut(reader)?;
        entry.wants = wants;
        if wants == Wants::Every && !self.is_reliable && !std::mem::replace(&mut readers.has_warned, true) {
            tracing::warn!(name = %self.name, %reader, "incompatible QoS: the reader asks for every message, and \
                                                        this writer offers the newest only (best effort); it takes \
                                                        those");
        }
        if entry.greeted != Some(challenge) {
            readers.lacks_latched = true;
            // One that asks again has lost what it knew, or has reason to doubt it: it begins with
            // what comes now.
            if entry.greeted.replace(challenge).is_some() {
                entry.from = self.admit(*reader)?;
            }
        }
        let (name, session, sequence, reliable) = (self.name, self.sealer.session, entry.from, self.is_reliable);
        Some(Feedback::Welcome { name, challenge, session, sequence, reliable })
    }

    /// A reader that was away is back. If it has begun anew, what is sent from now on is for it,
    /// also what goes before it asks.
    pub fn returned(&self, reader: &Name) {
        let readers = &mut *self.readers.lock();
        let Some(entry) = readers.known.get_mut(reader) else { return };
        if let Some(from) = self.admit(*reader) {
            (entry.from, entry.greeted) = (from, None);
        }
    }

    /// Takes what the RIB told of readers, and was verified.
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
                // Boxes are for readers; a RIB that is behind is the supervisor's business.
                PeerEvent::KeyBox(_) | PeerEvent::RibIsBehind(_) => {}
            }
        }
        self.sweep(readers, now_unix);
    }

    /// Lets go of readers whose right has ended, or that are absent for long.
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
        // Beyond what the transport keeps account of, readers get what the others get.
        let from = self.admit(entity).unwrap_or(1);
        readers.known.insert(entity, KnownReader { right, from, greeted: None, absent: None, wants: Wants::Newest });
    }

    /// The sequence that the reader begins with from now on, if the transport keeps account of it.
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

    /// What became of messages and frames so far, also once it is closed.
    pub fn counters(&self) -> TopicCounters {
        let now = self.scheduler.uplink().counters(self.topic());
        now.or_else(|| self.last_counters.get().copied()).unwrap_or_default()
    }

    /// Nothing is published any more.
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
