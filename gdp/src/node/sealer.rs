//! The first stage of the send path: seals the messages of one topic into segments and queues them
//! with the scheduler.
//!
//! Publishers and the sending thread call it, for new messages and for repeated ones. The
//! supervisor takes key boxes from it.

use std::sync::Arc;

use parking_lot::Mutex;

use super::ending::Ending;
use super::error::NodeError;
use super::latched::LatchedSamples;
use super::message_batch::{BATCH_WINDOW, MessageBatch};
use super::options::{PublishOptions, Reliability};
use super::scheduler::Scheduler;
use gdp_core::cert::Signed;
use gdp_core::crypto::{Backend, PUBLIC_KEY_LEN};
use gdp_core::identity::Identity;
use gdp_core::keys::KeyBox;
use gdp_e2e::keys::{Boxes, KeyRing, Omission, RingError};
use gdp_e2e::seal::{Draft, Encoding, SealError, Segments, Writer};
use gdp_e2e::transport::{Full, Sealed, TopicId};
use gdp_util::unix_time::unix_nanos;
use gdp_wire::Name;

/// Backoff in nanoseconds before unstored key boxes are offered again: the first and the longest
/// pause.
const FIRST_PAUSE: u64 = 1_000_000_000;
const LONGEST_PAUSE: u64 = 60_000_000_000;

/// Minimum interval in nanoseconds between two key boxes of readers that are verified. Readers show
/// theirs several times.
const BETWEEN_SHOWN: u64 = 100_000_000;

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
    /// The next messages to seal; empty while `pending` is set. Its first message waits until
    /// `batched_until`.
    batch: MessageBatch,
    batched_until: u64,
    /// The time of the last seal.
    sealed_at: u64,
    /// A sealed message that waits for space.
    pending: Option<Sealed>,
    latched: LatchedSamples,
    /// Key boxes that could not be stored yet.
    unstored: Option<Unstored>,
    /// Whether the RIB has refused boxes permanently.
    refused: bool,
    /// Number of statements that the RIB has taken.
    statements: u64,
    /// The time from which on another key box of a reader is verified.
    next_verification: u64,
}

struct Unstored {
    boxes: Boxes,
    /// The time of the next offer, in Unix nanoseconds, and the pause before it.
    at: u64,
    pause: u64,
}

/// The outcome of a push.
pub enum Pushed {
    Taken,
    /// The message waits in a batch. For its first message it contains the time at which to call
    /// [`Sealer::seal_batch`].
    Batched(Option<u64>),
    /// The message waits for space.
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
        let mut writer = Writer::new(name, identity.name(), identity.key().clone(), Backend::selected())?;
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
            statements: 0,
            next_verification: 0,
        };
        let (scheduler, ending, sealing) = (scheduler.clone(), ending.clone(), Mutex::new(sealing));
        Ok(Self { session, topic, name, scheduler, ending, sealing })
    }

    /// Checks that the publication has not ended.
    pub fn check(&self) -> Result<(), NodeError> {
        self.ending.get().map_or(Ok(()), |why| Err(why.clone().into()))
    }

    /// Returns the number of messages that the scheduler does not have yet.
    pub fn waiting(&self) -> u64 {
        let sealing = self.sealing.lock();
        let pending = sealing.pending.as_ref().map_or(0, |sealed| sealed.last() - sealed.first() + 1);
        pending + sealing.batch.len() as u64
    }

    /// Seals messages under one signature, or batches a small one that closely follows another.
    ///
    /// Returns `None` if a message still waits for space. Otherwise returns the sequence number of
    /// the first message. `begun` gets that number before anything can be sent.
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
                // If the last message is longer ago than this wait, another one soon is unlikely.
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
        sealing.seal(&self.scheduler, drafts, self.scheduler.max_payload_of(self.topic))?;
        begun.take().into_iter().for_each(|begun| begun(first));
        self.push_pending(sealing).map(taken(first))
    }

    /// Seals the batch if it is due by `due`.
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
        let sealed = sealing.seal(&self.scheduler, &batch.drafts(), self.scheduler.max_payload_of(self.topic));
        batch.clear();
        sealing.batch = batch;
        sealed?;
        self.push_pending(sealing)
    }

    /// Queues the pending message, and then the messages to send again.
    pub fn push_waiting(&self) -> Result<Pushed, NodeError> {
        self.check()?;
        let sealing = &mut *self.sealing.lock();
        loop {
            if let Pushed::Waits = self.push_pending(sealing)? {
                return Ok(Pushed::Waits);
            }
            // Batched messages already have their sequence numbers.
            if sealing.latched.has_again()
                && let Pushed::Waits = self.seal_all(sealing)?
            {
                return Ok(Pushed::Waits);
            }
            sealing.take_key()?;
            let Sealing { writer, ring, segments, latched, pending, .. } = sealing;
            let Some(draft) = latched.next_again() else { return Ok(Pushed::Taken) };
            writer.seal_batch(self.scheduler.stamp(), &[draft], self.scheduler.max_payload_of(self.topic), segments)?;
            ring.used(1, segments.total_bytes() as u64);
            *pending = Sealed::new(std::mem::take(segments));
        }
    }

    /// Sends a message about the name, and stores it for late-joining readers.
    pub fn pin(&self, encoding: Encoding, body: &[u8]) {
        self.sealing.lock().latched.pin(encoding, body);
        self.send_again();
    }

    /// Sends a message about the name.
    pub fn mention(&self, encoding: Encoding, body: &[u8]) {
        self.sealing.lock().latched.mention(encoding, body);
        self.send_again();
    }

    /// Sets the number of latched messages of this origin.
    pub fn limit_latched(&self, origin: &[u8], most: usize) {
        self.sealing.lock().latched.limit(origin, most);
    }

    /// Removes the latched messages of this origin.
    pub fn forget(&self, origin: &[u8]) {
        // Batched messages are latched when they are sealed.
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

    /// Makes the scheduler send the same messages in smaller frames, or drop them.
    pub fn reseal(&self, message: &Sealed) {
        let recut = self.recut(message, self.scheduler.max_payload_of(self.topic));
        let (now, mut uplink) = (self.scheduler.clock.now(), self.scheduler.uplink());
        match recut {
            Some(smaller) => uplink.resealed(now, self.topic, smaller),
            None => uplink.abandon(now, self.topic, message),
        }
    }

    /// Cuts the same messages into smaller frames. Returns `None` if that is impossible.
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

    /// Writes a heartbeat payload. It announces that all messages before `next` have been sent, and
    /// that those before `oldest` are no longer available.
    pub fn heartbeat(&self, next: u64, oldest: u64, out: &mut Vec<u8>) -> Result<(), SealError> {
        let sealing = &mut *self.sealing.lock();
        sealing.take_key()?;
        let Sealing { writer, segments, .. } = sealing;
        writer.heartbeat(self.scheduler.stamp(), next, oldest, segments)?;
        out.clear();
        segments.iter().for_each(|payload| out.extend_from_slice(payload));
        segments.clear();
        Ok(())
    }

    /// Sends the latched messages again, for readers that lack them.
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

    /// Sets the readers that keys are wrapped for. Returns those that cannot receive keys.
    pub fn set_readers(&self, readers: &[(Name, [u8; PUBLIC_KEY_LEN])]) -> Vec<(Name, Omission)> {
        self.sealing.lock().ring.set_readers(readers)
    }

    /// Processes the newest key box that a reader holds of this writer. Returns whether an epoch is
    /// to follow that one.
    pub fn take_newest(&self, reader: &Name, key_box: &Signed<KeyBox>) -> bool {
        let follows = {
            let (sealing, now) = (&mut *self.sealing.lock(), self.scheduler.clock.now());
            if now < sealing.next_verification {
                return false;
            }
            sealing.next_verification = now + BETWEEN_SHOWN;
            sealing.ring.take_newest(reader, key_box)
        };
        if follows {
            tracing::warn!(name = %self.name, "an earlier run used later epochs, so the clock has been set back; going on \
                                             after those");
        }
        follows
    }

    /// Returns the next key boxes to store with the RIB, if any.
    pub fn boxes(&self) -> Result<Option<Boxes>, RingError> {
        let (sealing, now) = (&mut *self.sealing.lock(), unix_nanos());
        match &sealing.unstored {
            // The clock may have been set back.
            Some(Unstored { at, .. }) if (now..now.saturating_add(LONGEST_PAUSE)).contains(at) => Ok(None),
            Some(unstored) => Ok(Some(unstored.boxes.clone())),
            None => sealing.ring.poll(now),
        }
    }

    /// Records that the RIB has stored these boxes.
    pub fn boxes_stored(&self, boxes: &Boxes) {
        let sealing = &mut *self.sealing.lock();
        sealing.unstored = None;
        sealing.ring.boxes_stored(boxes.epoch);
    }

    /// Schedules another offer of boxes that the RIB has not stored. The pauses increase if the RIB
    /// has no space for them.
    pub fn boxes_failed(&self, boxes: Boxes, no_room: bool) {
        let sealing = &mut *self.sealing.lock();
        let before = sealing.unstored.take().filter(|_| no_room);
        let pause = before.map_or(FIRST_PAUSE, |before| (2 * before.pause).min(LONGEST_PAUSE));
        sealing.unstored = Some(Unstored { boxes, at: unix_nanos() + pause, pause });
    }

    /// Returns the number of statements that the RIB has taken, for [`Self::boxes_refused`].
    pub fn statements(&self) -> u64 {
        self.sealing.lock().statements
    }

    /// Records that the RIB refuses these boxes permanently, until [another
    /// statement](Self::stated). `statements`: their number when the boxes were offered. The answer
    /// to a later statement may overtake the refusal; the boxes are then offered again.
    pub fn boxes_refused(&self, statements: u64) {
        let sealing = &mut *self.sealing.lock();
        (sealing.unstored, sealing.refused) = (None, sealing.statements == statements);
        if !sealing.refused {
            sealing.ring.republish();
        }
    }

    /// Records that the RIB has the current statement, and offers refused boxes again.
    pub fn stated(&self) {
        let refused = {
            let sealing = &mut *self.sealing.lock();
            sealing.statements += 1;
            std::mem::take(&mut sealing.refused)
        };
        if refused {
            self.store_again();
        }
    }

    /// Offers all boxes again, because the RIB may have lost them.
    pub fn store_again(&self) {
        let sealing = &mut *self.sealing.lock();
        (sealing.unstored, sealing.refused) = (None, false);
        sealing.ring.republish();
    }

    /// Returns the time at which boxes may be available, in Unix nanoseconds.
    pub fn boxes_at(&self) -> u64 {
        let sealing = self.sealing.lock();
        sealing.unstored.as_ref().map_or_else(|| sealing.ring.wake_at(), |unstored| unstored.at)
    }
}

impl Sealing {
    /// Seals the next messages.
    fn seal(&mut self, scheduler: &Scheduler, drafts: &[Draft<'_>], max_payload: usize) -> Result<(), SealError> {
        self.take_key()?;
        let Self { writer, ring, segments, latched, pending, sealed_at, .. } = self;
        let (first, timestamp_ns) = (writer.next_sequence(), scheduler.stamp());
        writer.seal_batch(timestamp_ns, drafts, max_payload, segments)?;
        ring.used(drafts.len() as u64, segments.total_bytes() as u64);
        latched.keep(first, timestamp_ns, drafts);
        (*pending, *sealed_at) = (Sealed::new(std::mem::take(segments)), scheduler.clock.now());
        Ok(())
    }

    /// Switches to the key ring's current key.
    fn take_key(&mut self) -> Result<(), SealError> {
        let (epoch, key) = self.ring.current();
        if self.writer.epoch() != Some(epoch) { self.writer.set_epoch(epoch, key) } else { Ok(()) }
    }
}
