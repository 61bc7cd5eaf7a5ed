//! The first stage of the send path: seals the messages of one topic into segments, and has the
//! scheduler queue them. Publishers and the sending thread call it, for new messages and for those
//! that go again; the supervisor takes wrapped keys from it.

use std::sync::Arc;

use parking_lot::Mutex;

use super::ending::Ending;
use super::error::NodeError;
use super::latched::LatchedSamples;
use super::message_batch::{BATCH_WINDOW, MessageBatch};
use super::options::{PublishOptions, Reliability};
use super::scheduler::Scheduler;
use gdp_core::crypto::{Backend, PUBLIC_KEY_LEN};
use gdp_core::identity::Identity;
use gdp_e2e::keys::{Boxes, KeyRing, Omission, RingError};
use gdp_e2e::seal::{Draft, Encoding, SealError, Segments, Writer};
use gdp_e2e::transport::{Full, Sealed, TopicId};
use gdp_util::unix_time::unix_nanos;
use gdp_wire::Name;

/// Key boxes that could not be stored are offered again after so long, then less and less often.
const FIRST_PAUSE: u64 = 1_000_000_000;
const LONGEST_PAUSE: u64 = 60_000_000_000;

pub struct Sealer {
    pub session: [u8; 16],
    pub topic: TopicId,
    name: Name,
    scheduler: Arc<Scheduler>,
    ending: Arc<Ending>,
    sealing: Mutex<Sealing>,
}

struct Sealing {
    writer: Writer,
    ring: KeyRing,
    segments: Segments,
    /// Comes next; empty while something is pending. The first of it waits until then.
    batch: MessageBatch,
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

/// What became of a message.
pub enum Pushed {
    Taken,
    /// It waits for others. The first that does says until when: then [`Sealer::seal_batch`]
    /// is to be called.
    Batched(Option<u64>),
    /// It waits for room.
    Waits,
}

impl Sealer {
    pub fn new(
        name: Name,
        identity: &Identity,
        options: &PublishOptions,
        scheduler: &Arc<Scheduler>,
        ending: &Arc<Ending>,
    ) -> Result<Self, NodeError> {
        let mut writer = Writer::new(name, identity.name(), identity.key().clone(), Backend::default())?;
        let ring = KeyRing::new(name, identity, options.rotation, unix_nanos())?;
        let (epoch, key) = ring.current();
        writer.set_epoch(epoch, key)?;
        let session = writer.session();
        let topic = scheduler.uplink().open(scheduler.clock.now(), name, session, (*options).into());
        let is_reliable = matches!(options.reliability, Reliability::Reliable { .. });
        let sealing = Sealing {
            writer,
            ring,
            segments: Segments::new(),
            batch: MessageBatch::new(is_reliable.then_some(options.history)),
            batched_until: 0,
            sealed_at: 0,
            pending: None,
            latched: LatchedSamples::new(options.latched),
            unstored: None,
            refused: false,
        };
        let (scheduler, ending, sealing) = (scheduler.clone(), ending.clone(), Mutex::new(sealing));
        Ok(Self { session, topic, name, scheduler, ending, sealing })
    }

    /// Whether anything can be sent still.
    pub fn check(&self) -> Result<(), NodeError> {
        self.ending.get().map_or(Ok(()), |why| Err(why.clone().into()))
    }

    /// Messages that the scheduler does not have yet.
    pub fn waiting(&self) -> u64 {
        let sealing = self.sealing.lock();
        let pending = sealing.pending.as_ref().map_or(0, |sealed| sealed.last() - sealed.first() + 1);
        pending + sealing.batch.len() as u64
    }

    /// Seals messages under one signature, or batches what is small and comes soon after another;
    /// unless one waits for room still. Returns the sequence of the first, which `begun` gets
    /// before anything can go.
    pub fn push(
        &self,
        drafts: &[Draft<'_>],
        begun: &mut Option<impl FnOnce(u64)>,
    ) -> Result<Option<(u64, Pushed)>, NodeError> {
        self.check()?;
        let sealing = &mut *self.sealing.lock();
        if sealing.pending.is_some() {
            return Ok(None);
        }
        let (now, taken) = (self.scheduler.clock.now(), |first| move |pushed| Some((first, pushed)));
        if MessageBatch::takes(drafts) {
            let begins = sealing.batch.is_empty();
            if begins {
                // As long as the last one was ago, another is not likely to come.
                let wait = (self.scheduler.turns.take(now) - now).max(BATCH_WINDOW);
                let is_soon = now.saturating_sub(sealing.sealed_at) < wait;
                sealing.batched_until = if is_soon { now + wait } else { now };
            }
            let waits = sealing.batched_until > now;
            if waits || !begins {
                let first = sealing.writer.next_sequence() + sealing.batch.len() as u64;
                sealing.batch.push(&drafts[0]);
                begun.take().into_iter().for_each(|begun| begun(first));
                if !waits || sealing.batch.is_full() {
                    return self.seal_all(sealing).map(taken(first));
                }
                return Ok(Some((first, Pushed::Batched(begins.then_some(sealing.batched_until)))));
            }
        }
        if let Pushed::Waits = self.seal_all(sealing)? {
            return Ok(None);
        }
        let first = sealing.writer.next_sequence();
        sealing.seal(now, drafts, self.scheduler.max_payload_of(self.topic))?;
        begun.take().into_iter().for_each(|begun| begun(first));
        self.push_pending(sealing).map(taken(first))
    }

    /// Seals what is batched and waits no longer than until `due`.
    pub fn seal_batch(&self, due: u64) -> Result<Pushed, NodeError> {
        self.check()?;
        let sealing = &mut *self.sealing.lock();
        if sealing.batched_until > due { Ok(Pushed::Taken) } else { self.seal_all(sealing) }
    }

    fn seal_all(&self, sealing: &mut Sealing) -> Result<Pushed, NodeError> {
        if sealing.batch.is_empty() {
            return Ok(Pushed::Taken);
        }
        let mut batch = std::mem::replace(&mut sealing.batch, MessageBatch::new(None));
        let sealed =
            sealing.seal(self.scheduler.clock.now(), &batch.drafts(), self.scheduler.max_payload_of(self.topic));
        batch.clear();
        sealing.batch = batch;
        sealed?;
        self.push_pending(sealing)
    }

    /// Brings what waits for room into the outbox, and then what is to be sent again.
    pub fn push_waiting(&self) -> Result<Pushed, NodeError> {
        self.check()?;
        let sealing = &mut *self.sealing.lock();
        loop {
            if let Pushed::Waits = self.push_pending(sealing)? {
                return Ok(Pushed::Waits);
            }
            // What is batched has its sequences already.
            if sealing.latched.has_again()
                && let Pushed::Waits = self.seal_all(sealing)?
            {
                return Ok(Pushed::Waits);
            }
            sealing.take_key()?;
            let Sealing { writer, ring, segments, latched, pending, .. } = sealing;
            let Some(draft) = latched.next_again() else { return Ok(Pushed::Taken) };
            writer.seal_batch(unix_nanos(), &[draft], self.scheduler.max_payload_of(self.topic), segments)?;
            ring.used(1, segments.total_bytes() as u64);
            *pending = Sealed::new(std::mem::take(segments));
        }
    }

    /// Sends a message about the name, and keeps it for readers that come later.
    pub fn pin(&self, encoding: Encoding, body: &[u8]) {
        self.sealing.lock().latched.pin(encoding, body);
        self.send_again();
    }

    /// Sends a message about the name.
    pub fn mention(&self, encoding: Encoding, body: &[u8]) {
        self.sealing.lock().latched.mention(encoding, body);
        self.send_again();
    }

    /// Latches so many of this origin.
    pub fn limit_latched(&self, origin: &[u8], most: usize) {
        self.sealing.lock().latched.limit(origin, most);
    }

    /// Latches nothing of this origin any more.
    pub fn forget(&self, origin: &[u8]) {
        // What is batched is latched when it is sealed.
        if self.seal_batch(u64::MAX).is_ok() {
            self.scheduler.wake();
        }
        self.sealing.lock().latched.forget(origin);
    }

    fn push_pending(&self, sealing: &mut Sealing) -> Result<Pushed, NodeError> {
        let Some(sealed) = sealing.pending.take() else { return Ok(Pushed::Taken) };
        let pushed = self.scheduler.uplink().push(self.scheduler.clock.now(), self.topic, sealed);
        match pushed {
            Ok(()) => Ok(Pushed::Taken),
            Err(Full::Wait(sealed)) => {
                sealing.pending = Some(sealed);
                Ok(Pushed::Waits)
            }
            Err(Full::Refused(_)) => Err(NodeError::Closed),
        }
    }

    /// Has the scheduler send the same messages in smaller frames, or give them up.
    pub fn reseal(&self, message: &Sealed) {
        let recut = self.recut(message, self.scheduler.max_payload_of(self.topic));
        let (now, mut uplink) = (self.scheduler.clock.now(), self.scheduler.uplink());
        match recut {
            Some(smaller) => uplink.resealed(now, self.topic, smaller),
            None => uplink.abandon(now, self.topic, message),
        }
    }

    /// The same messages for smaller frames; `None` if they cannot be had any more.
    fn recut(&self, message: &Sealed, max_payload: usize) -> Option<Sealed> {
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

    /// Has the latched messages sent again, for readers that lack them.
    pub fn send_latched(&self) {
        self.sealing.lock().latched.again();
        self.send_again();
    }

    fn send_again(&self) {
        match self.push_waiting() {
            Ok(_) => self.scheduler.wake(),
            Err(error) => tracing::debug!(name = %self.name, %error, "what is kept for readers could not be sent"),
        }
    }

    /// Wraps keys for these readers, and for no others. Returns those that cannot have any.
    pub fn set_readers(&self, readers: &[(Name, [u8; PUBLIC_KEY_LEN])]) -> Vec<(Name, Omission)> {
        self.sealing.lock().ring.set_readers(readers)
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
