//! A name that this node publishes, whoever works for it: the application's handle seals, the
//! sending thread seals again and says how far it is, the receiving thread answers readers, the
//! supervisor wraps keys.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::Notify;

use super::ending::{Ended, Ending};
use super::latched::LatchedSamples;
use super::message_batch::{GATHERING, MessageBatch};
use super::options::PublishOptions;
use super::publisher::Unflushed;
use super::send_path::SendPath;
use super::{NodeError, Reliability};
use gdp_core::cert::Revocation;
use gdp_core::crypto::{Backend, PUBLIC_KEY_LEN};
use gdp_core::identity::Identity;
use gdp_e2e::feedback_wire::{Feedback, Wants};
use gdp_e2e::keys::{Boxes, KeyRing, RingError};
use gdp_e2e::seal::{Draft, Encoding, SealError, Segments, Writer};
use gdp_e2e::transport::{Full, Sealed, Topic, TopicCounters};
use gdp_proto::peers::{Counterpart, PeerEvent};
use gdp_util::unix_time::unix_nanos;

/// A reader that is not attached any more keeps its place and its keys for so long: links come
/// back.
const ABSENCE: u64 = 60_000_000_000;

/// Key boxes that could not be stored are offered again after so long, then less and less often.
const FIRST_PAUSE: u64 = 1_000_000_000;
const LONGEST_PAUSE: u64 = 60_000_000_000;

/// Latched messages go to all readers again when one comes; however many come, not more often.
const BETWEEN_LATCHES: u64 = 1_000_000_000;

/// Readers that are absent and keep their places; of more, the one longest away loses it.
const MOST_ABSENT: usize = 64;

pub struct Publication {
    pub name: Name,
    pub session: [u8; 16],
    pub topic: Topic,
    /// There is room again for a publisher that waits, or no sense in waiting: it is to look.
    pub room: Notify,
    /// Boxes are handed out by one task at a time.
    pub boxing: tokio::sync::Mutex<()>,
    is_reliable: bool,
    sealing: Mutex<Sealing>,
    readers: Mutex<Readers>,
    pub ending: Arc<Ending>,
    last_counters: OnceLock<TopicCounters>,
}

struct Sealing {
    writer: Writer,
    ring: KeyRing,
    segments: Segments,
    /// Comes next; empty while something is pending. The first of it waits until then.
    gathered: MessageBatch,
    batched_until: u64,
    /// When something was sealed last.
    sealed_at: u64,
    /// Sealed, and waits for room.
    pending: Option<Sealed>,
    latched: LatchedSamples,
    /// Boxes that could not be stored yet.
    unstored: Option<Unstored>,
    /// Some were refused for good.
    refused: bool,
}

struct Unstored {
    boxes: Boxes,
    /// When they are offered again, in Unix nanoseconds, and how long it was waited for that.
    at: u64,
    pause: u64,
}

#[derive(Default)]
struct Readers {
    known: HashMap<Name, Reader>,
    revocation: Option<Revocation>,
    /// One was welcomed since the latched messages went again, and when that was.
    lacks_latched: bool,
    latched_at: Option<u64>,
    /// The log has told of a reader that asks for more than is offered.
    told_incompatible: bool,
}

struct Reader {
    right: Counterpart,
    /// What it is told to begin with.
    from: u64,
    /// The challenge that was answered last.
    greeted: Option<[u8; 16]>,
    /// Since when it is not attached.
    absent: Option<u64>,
    wants: Wants,
}

/// What became of a message.
pub enum Pushed {
    Taken,
    /// It waits for others. The first that does says until when: then [`Publication::seal_batch`]
    /// is to be called.
    MessageBatch(Option<u64>),
    /// It waits for room.
    Waits,
}

impl Readers {
    fn attached(&self) -> impl Iterator<Item = (&Name, &Reader)> {
        self.known.iter().filter(|(_, reader)| reader.absent.is_none())
    }

    /// Whether one is attached that asks for every message, as far as it has said.
    fn asks_for_all(&self, reader: &Name) -> bool {
        let asks =
            |reader: &Reader| reader.absent.is_none() && (reader.wants != Wants::Newest || reader.greeted.is_none());
        self.known.get(reader).is_some_and(asks)
    }
}

impl Publication {
    pub fn new(
        name: Name,
        identity: &Identity,
        options: &PublishOptions,
        send_path: &SendPath,
    ) -> Result<Self, NodeError> {
        let mut writer = Writer::new(name, identity.name(), identity.key().clone(), Backend::default())?;
        let ring = KeyRing::new(name, identity, options.rotation, unix_nanos())?;
        let (epoch, key) = ring.current();
        writer.set_epoch(epoch, key)?;
        let session = writer.session();
        let topic = send_path.uplink.lock().open(send_path.clock.now(), name, session, (*options).into());
        let (segments, latched) = (Segments::new(), LatchedSamples::new(options.latched));
        let is_reliable = matches!(options.reliability, Reliability::Reliable { .. });
        let gathered = MessageBatch::new(is_reliable.then_some(options.history));
        let sealing = Sealing {
            writer,
            ring,
            segments,
            gathered,
            batched_until: 0,
            sealed_at: 0,
            pending: None,
            latched,
            unstored: None,
            refused: false,
        };
        Ok(Self {
            name,
            session,
            topic,
            room: Notify::new(),
            boxing: tokio::sync::Mutex::default(),
            is_reliable,
            sealing: Mutex::new(sealing),
            readers: Mutex::default(),
            ending: Arc::default(),
            last_counters: OnceLock::new(),
        })
    }

    /// What is best effort fails while there is no link; what is reliable waits for one.
    pub fn check_link(&self, send_path: &SendPath) -> Result<(), NodeError> {
        match send_path.sending_on() {
            Err(NodeError::Detached(_)) if self.is_reliable => Ok(()),
            link => link.map(drop),
        }
    }

    pub fn check(&self) -> Result<(), NodeError> {
        self.ending.get().map_or(Ok(()), |why| Err(why.clone().into()))
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
    pub fn unfinished(&self, send_path: &SendPath) -> Unflushed {
        let readers = self.readers.lock();
        let waiting = {
            let sealing = self.sealing.lock();
            let pending = sealing.pending.as_ref().map_or(0, |sealed| sealed.last() - sealed.first() + 1);
            pending + sealing.gathered.len() as u64
        };
        let (unsent, lacking) = send_path.uplink.lock().unfinished(self.topic).unwrap_or_default();
        let lacking = lacking.into_iter().filter(|(reader, _)| self.is_reliable && readers.asks_for_all(reader));
        Unflushed { unsent: unsent + waiting, unacknowledged: lacking.collect() }
    }

    /// Seals messages under one signature, or gathers what is small and comes soon after another;
    /// unless one waits for room still. Returns the sequence of the first, which `begun` is told
    /// before anything can go.
    pub fn push(
        &self,
        send_path: &SendPath,
        drafts: &[Draft<'_>],
        begun: &mut Option<impl FnOnce(u64)>,
    ) -> Result<Option<(u64, Pushed)>, NodeError> {
        self.check()?;
        let sealing = &mut *self.sealing.lock();
        if sealing.pending.is_some() {
            return Ok(None);
        }
        let (now, taken) = (send_path.clock.now(), |first| move |pushed| Some((first, pushed)));
        if MessageBatch::takes(drafts) {
            let begins = sealing.gathered.is_empty();
            if begins {
                // As long as the last one was ago, another is not likely to come.
                let wait = (send_path.turns.take(now) - now).max(GATHERING);
                let is_soon = now.saturating_sub(sealing.sealed_at) < wait;
                sealing.batched_until = if is_soon { now + wait } else { now };
            }
            let waits = sealing.batched_until > now;
            if waits || !begins {
                let first = sealing.writer.next_sequence() + sealing.gathered.len() as u64;
                sealing.gathered.push(&drafts[0]);
                begun.take().into_iter().for_each(|begun| begun(first));
                if !waits || sealing.gathered.is_full() {
                    return self.seal_all(send_path, sealing).map(taken(first));
                }
                return Ok(Some((first, Pushed::MessageBatch(begins.then_some(sealing.batched_until)))));
            }
        }
        if let Pushed::Waits = self.seal_all(send_path, sealing)? {
            return Ok(None);
        }
        let first = sealing.writer.next_sequence();
        sealing.seal(now, drafts, send_path.max_payload_of(self.topic))?;
        begun.take().into_iter().for_each(|begun| begun(first));
        self.push_pending(send_path, sealing).map(taken(first))
    }

    /// Seals what was gathered and waits no longer than until `due`.
    pub fn seal_batch(&self, send_path: &SendPath, due: u64) -> Result<Pushed, NodeError> {
        self.check()?;
        let sealing = &mut *self.sealing.lock();
        if sealing.batched_until > due { Ok(Pushed::Taken) } else { self.seal_all(send_path, sealing) }
    }

    /// What was gathered waits for nothing more.
    pub fn finish(&self, send_path: &SendPath) {
        if self.seal_batch(send_path, u64::MAX).is_ok() {
            send_path.send();
        }
    }

    fn seal_all(&self, send_path: &SendPath, sealing: &mut Sealing) -> Result<Pushed, NodeError> {
        if sealing.gathered.is_empty() {
            return Ok(Pushed::Taken);
        }
        let mut gathered = std::mem::replace(&mut sealing.gathered, MessageBatch::new(None));
        let sealed = sealing.seal(send_path.clock.now(), &gathered.drafts(), send_path.max_payload_of(self.topic));
        gathered.clear();
        sealing.gathered = gathered;
        sealed?;
        self.push_pending(send_path, sealing)
    }

    /// Brings what waits for room into the outbox, and then what is to be sent again.
    pub fn push_waiting(&self, send_path: &SendPath) -> Result<Pushed, NodeError> {
        self.check()?;
        let sealing = &mut *self.sealing.lock();
        loop {
            if let Pushed::Waits = self.push_pending(send_path, sealing)? {
                return Ok(Pushed::Waits);
            }
            // What was gathered has its sequences already.
            if sealing.latched.has_again()
                && let Pushed::Waits = self.seal_all(send_path, sealing)?
            {
                return Ok(Pushed::Waits);
            }
            sealing.take_key()?;
            let Sealing { writer, ring, segments, latched, pending, .. } = sealing;
            let Some(draft) = latched.next_again() else { return Ok(Pushed::Taken) };
            writer.seal_batch(unix_nanos(), &[draft], send_path.max_payload_of(self.topic), segments)?;
            ring.used(1, segments.total_bytes() as u64);
            *pending = Sealed::new(std::mem::take(segments));
        }
    }

    /// Sends the latched messages again, if a reader has come that lacks them.
    pub fn latch(&self, send_path: &SendPath) {
        let now = send_path.clock.now();
        {
            let readers = &mut *self.readers.lock();
            let soon = readers.latched_at.is_some_and(|last| now.saturating_sub(last) < BETWEEN_LATCHES);
            if !readers.lacks_latched || soon {
                return;
            }
            (readers.lacks_latched, readers.latched_at) = (false, Some(now));
        }
        self.sealing.lock().latched.again();
        self.send_again(send_path);
    }

    fn send_again(&self, send_path: &SendPath) {
        match self.push_waiting(send_path) {
            Ok(_) => send_path.wake(),
            Err(error) => tracing::debug!(name = %self.name, %error, "what is kept for readers could not be sent"),
        }
    }

    /// Sends a message about the name, and keeps it for readers that come later.
    pub fn pin(&self, send_path: &SendPath, encoding: Encoding, body: &[u8]) {
        self.sealing.lock().latched.pin(encoding, body);
        self.send_again(send_path);
    }

    /// Sends a message about the name.
    pub fn mention(&self, send_path: &SendPath, encoding: Encoding, body: &[u8]) {
        self.sealing.lock().latched.mention(encoding, body);
        self.send_again(send_path);
    }

    /// Latches so many of this origin.
    pub fn limit_latched(&self, origin: &[u8], most: usize) {
        self.sealing.lock().latched.limit(origin, most);
    }

    /// Latches nothing of this origin any more.
    pub fn forget(&self, send_path: &SendPath, origin: &[u8]) {
        // What was gathered is latched when it is sealed.
        self.finish(send_path);
        self.sealing.lock().latched.forget(origin);
    }

    fn push_pending(&self, send_path: &SendPath, sealing: &mut Sealing) -> Result<Pushed, NodeError> {
        let Some(sealed) = sealing.pending.take() else { return Ok(Pushed::Taken) };
        let pushed = send_path.uplink.lock().push(send_path.clock.now(), self.topic, sealed);
        match pushed {
            Ok(()) => Ok(Pushed::Taken),
            Err(Full::Wait(sealed)) => {
                sealing.pending = Some(sealed);
                Ok(Pushed::Waits)
            }
            Err(Full::Refused(_)) => Err(NodeError::Closed),
        }
    }

    /// The same messages for smaller frames; `None` if they cannot be had any more.
    pub fn recut(&self, message: &Sealed, max_payload: usize) -> Option<Sealed> {
        let sealing = &mut *self.sealing.lock();
        let Sealing { writer, ring, segments, .. } = sealing;
        let cut = message.cut().checked_add(1)?;
        if let Err(error) = writer.recut(message.bytes(), cut, max_payload, segments) {
            tracing::warn!(name = %self.name, %error, "messages are lost that are too large for the path now");
            return None;
        }
        ring.used(message.last() - message.first() + 1, segments.total_bytes() as u64);
        Sealed::new(std::mem::take(segments))
    }

    /// The payload of a frame that says that all before `next` has gone, and what comes before
    /// `oldest` cannot be had again.
    pub fn heartbeat(&self, next: u64, oldest: u64, out: &mut Vec<u8>) -> Result<(), SealError> {
        let sealing = &mut *self.sealing.lock();
        sealing.take_key()?;
        let Sealing { writer, segments, .. } = sealing;
        writer.heartbeat(unix_nanos(), next, oldest, segments)?;
        out.clear();
        segments.iter().for_each(|payload| out.extend_from_slice(payload));
        segments.clear();
        Ok(())
    }

    /// Answers a reader that asks which session this is.
    pub fn welcome(&self, send_path: &SendPath, reader: &Name, challenge: [u8; 16], wants: Wants) -> Option<Feedback> {
        let readers = &mut *self.readers.lock();
        let entry = readers.known.get_mut(reader)?;
        entry.wants = wants;
        if wants == Wants::Every && !self.is_reliable && !std::mem::replace(&mut readers.told_incompatible, true) {
            tracing::warn!(name = %self.name, %reader, "incompatible QoS: the reader asks for every message, and \
                                                        this writer offers the newest only (best effort); it takes \
                                                        those");
        }
        if entry.greeted != Some(challenge) {
            readers.lacks_latched = true;
            // One that asks again has lost what it knew, or has reason to doubt it: it begins with
            // what comes now.
            if entry.greeted.replace(challenge).is_some() {
                entry.from = send_path.uplink.lock().join(send_path.clock.now(), self.topic, *reader)?;
            }
        }
        let (name, session, sequence, reliable) = (self.name, self.session, entry.from, self.is_reliable);
        Some(Feedback::Welcome { name, challenge, session, sequence, reliable })
    }

    /// A reader that was away is back. If it has begun anew, what is sent from now on is for it,
    /// also what goes before it asks.
    pub fn returned(&self, send_path: &SendPath, reader: &Name) {
        let readers = &mut *self.readers.lock();
        let Some(entry) = readers.known.get_mut(reader) else { return };
        if let Some(from) = send_path.uplink.lock().join(send_path.clock.now(), self.topic, *reader) {
            (entry.from, entry.greeted) = (from, None);
        }
    }

    /// Takes what the RIB told of readers, and was verified.
    pub fn take(&self, send_path: &SendPath, now_unix: u64, events: impl IntoIterator<Item = PeerEvent>) {
        let readers = &mut *self.readers.lock();
        for event in events {
            match event {
                PeerEvent::Joined(right) => self.join(send_path, readers, right),
                PeerEvent::Left(reader) => {
                    if let Some(entry) = readers.known.get_mut(&reader) {
                        entry.absent = entry.absent.or(Some(send_path.clock.now()));
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
        self.sweep(send_path, readers, now_unix);
    }

    /// Lets go of readers whose right has ended, or that are absent for long.
    pub fn expire(&self, send_path: &SendPath, now_unix: u64) {
        self.sweep(send_path, &mut self.readers.lock(), now_unix);
    }

    fn join(&self, send_path: &SendPath, readers: &mut Readers, right: Counterpart) {
        let (entity, box_key) = (right.entity, right.box_key);
        if let Some(entry) = readers.known.get_mut(&entity) {
            if entry.right.box_key != box_key {
                let mut pairs = send_path.pairs.lock();
                pairs.introduce(entity, box_key);
                pairs.part(&entity);
            }
            (entry.right, entry.absent) = (right, None);
            return;
        }
        send_path.pairs.lock().introduce(entity, box_key);
        let mut uplink = send_path.uplink.lock();
        // Beyond what the transport keeps account of, readers get what the others get.
        let from = uplink.join(send_path.clock.now(), self.topic, entity).unwrap_or(1);
        readers.known.insert(entity, Reader { right, from, greeted: None, absent: None, wants: Wants::Newest });
    }

    fn sweep(&self, send_path: &SendPath, readers: &mut Readers, now_unix: u64) {
        let now = send_path.clock.now();
        let Readers { known, revocation, .. } = readers;
        let too_many = known.values().filter(|reader| reader.absent.is_some()).count().saturating_sub(MOST_ABSENT);
        let mut away: Vec<_> = known.iter().filter_map(|(name, reader)| Some((reader.absent?, *name))).collect();
        away.sort_unstable();
        let holds = |reader: &Reader| {
            reader.right.not_after >= now_unix && revocation.as_ref().is_none_or(|r| reader.right.holds(r))
        };
        let longest = away.iter().take(too_many).map(|(_, name)| *name);
        let ended = known.iter().filter(|(_, reader)| {
            !holds(reader) || reader.absent.is_some_and(|since| now.saturating_sub(since) > ABSENCE)
        });
        let gone: Vec<Name> = ended.map(|(name, _)| *name).chain(longest).collect();
        for reader in gone.into_iter().filter(|reader| known.remove(reader).is_some()) {
            send_path.uplink.lock().leave(now, self.topic, &reader);
            send_path.pairs.lock().part(&reader);
        }
        let readers: Vec<(Name, [u8; PUBLIC_KEY_LEN])> =
            known.iter().map(|(name, reader)| (*name, reader.right.box_key)).collect();
        for (reader, why) in self.sealing.lock().ring.set_readers(&readers) {
            tracing::warn!(name = %self.name, %reader, "it gets no keys: {why}");
        }
    }

    /// Boxes to be stored with the RIB next, if there are any.
    pub fn boxes(&self) -> Result<Option<Boxes>, RingError> {
        let (sealing, now) = (&mut *self.sealing.lock(), unix_nanos());
        match &sealing.unstored {
            // The clock may have been set back.
            Some(Unstored { at, .. }) if (now..now.saturating_add(LONGEST_PAUSE)).contains(at) => Ok(None),
            Some(unstored) => Ok(Some(unstored.boxes.clone())),
            None => sealing.ring.poll(now),
        }
    }

    /// The RIB has taken these.
    pub fn boxes_stored(&self, boxes: &Boxes) {
        let sealing = &mut *self.sealing.lock();
        sealing.unstored = None;
        sealing.ring.boxes_stored(boxes.epoch);
    }

    /// The RIB has not: they are offered again, and if it has no room for them, less and less
    /// often.
    pub fn boxes_failed(&self, boxes: Boxes, no_room: bool) {
        let sealing = &mut *self.sealing.lock();
        let before = sealing.unstored.take().filter(|_| no_room);
        let pause = before.map_or(FIRST_PAUSE, |before| (2 * before.pause).min(LONGEST_PAUSE));
        sealing.unstored = Some(Unstored { boxes, at: unix_nanos() + pause, pause });
    }

    /// The RIB never takes these, unless [something else](Self::stated) is stated.
    pub fn boxes_refused(&self) {
        let sealing = &mut *self.sealing.lock();
        (sealing.unstored, sealing.refused) = (None, true);
    }

    /// The RIB knows by now what the right to it is.
    pub fn stated(&self) {
        let refused = std::mem::take(&mut self.sealing.lock().refused);
        if refused {
            self.store_again();
        }
    }

    /// The RIB may have lost the boxes.
    pub fn store_again(&self) {
        let sealing = &mut *self.sealing.lock();
        (sealing.unstored, sealing.refused) = (None, false);
        sealing.ring.republish();
    }

    /// When there may be boxes, in Unix nanoseconds.
    pub fn boxes_at(&self) -> u64 {
        let sealing = self.sealing.lock();
        sealing.unstored.as_ref().map_or_else(|| sealing.ring.wake_at(), |unstored| unstored.at)
    }

    /// What became of messages and frames so far, also once it is closed.
    pub fn counters(&self, send_path: &SendPath) -> TopicCounters {
        let now = send_path.uplink.lock().counters(self.topic);
        now.or_else(|| self.last_counters.get().copied()).unwrap_or_default()
    }

    /// Nothing is published any more.
    pub fn close(&self, send_path: &SendPath) {
        {
            let mut uplink = send_path.uplink.lock();
            uplink.counters(self.topic).map(|last| self.last_counters.set(last));
            uplink.close(self.topic);
        }
        self.ending.end(Ended::Closed);
        let readers = std::mem::take(&mut self.readers.lock().known);
        let mut pairs = send_path.pairs.lock();
        readers.keys().for_each(|reader| pairs.part(reader));
    }
}

impl Sealing {
    /// Seals what comes next.
    fn seal(&mut self, now: u64, drafts: &[Draft<'_>], max_payload: usize) -> Result<(), SealError> {
        self.take_key()?;
        let Self { writer, ring, segments, latched, pending, sealed_at, .. } = self;
        let (first, timestamp_ns) = (writer.next_sequence(), unix_nanos());
        writer.seal_batch(timestamp_ns, drafts, max_payload, segments)?;
        ring.used(drafts.len() as u64, segments.total_bytes() as u64);
        latched.keep(first, timestamp_ns, drafts);
        (*pending, *sealed_at) = (Sealed::new(std::mem::take(segments)), now);
        Ok(())
    }

    /// Seals with the ring's current key from now on.
    fn take_key(&mut self) -> Result<(), SealError> {
        let (epoch, key) = self.ring.current();
        if self.writer.epoch() != Some(epoch) { self.writer.set_epoch(epoch, key) } else { Ok(()) }
    }
}
