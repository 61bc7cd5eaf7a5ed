//! A subscription in the receiving thread: the reader, its authorised writers, the state of each
//! writer's session, and the queue to the application.
//!
//! The receiving thread sends its feedback to writers.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use gdp_wire::Name;
use tokio::sync::mpsc;

use super::clock_check::ClockCheck;
use super::counters::Counters;
use super::greeting::Greeting;
use super::options::SubscribeOptions;
use super::outgoing_feedback::OutgoingFeedback;
use super::queue_state::QueueState;
use gdp_core::crypto::Backend;
use gdp_core::identity::VerifyKey;
use gdp_e2e::feedback_wire::{Feedback, Wants};
use gdp_e2e::keys::Opened;
use gdp_e2e::seal::{DropReason, Message, Reader, Received, Timestamps, segment_ids};
use gdp_e2e::transport::{Arrival, Inbound, InboundCounters, Segment};
use gdp_util::unix_time::unix_nanos;

/// A change of a reader's writers and keys.
#[derive(Debug)]
pub enum Change {
    /// This writer's right was verified.
    Authorise {
        writer: Name,
        key: VerifyKey,
    },
    Revoke {
        writer: Name,
    },
    /// The writer's key.
    Key {
        writer: Name,
        opened: Opened,
    },
    DropKey {
        writer: Name,
        epoch: u32,
    },
}

/// The outcome of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Used, or dropped and counted.
    Done,
    /// Not usable yet, for this reason. If it expires, it counts as this number of drops.
    Early(DropReason, u64),
}

/// The thread's side of a subscription.
pub struct SubscriptionReceiver {
    name: Name,
    reader: Reader,
    options: SubscribeOptions,
    queue: mpsc::Sender<Message>,
    shared: Arc<QueueState>,
    writers: HashMap<Name, KnownWriter>,
    /// Messages of reliable sessions that do not fit the application's queue yet.
    stalled: VecDeque<Message>,
    /// Empty between calls; retains its capacity.
    received: Received,
    seen_drops: [u64; DropReason::COUNT],
    /// The subscription's entry in the thread's timers.
    pub timer: Option<u64>,
    /// Whether frames were received since the subscription was last polled.
    pub is_touched: bool,
}

#[derive(Default)]
struct KnownWriter {
    greeting: Greeting,
    clock: ClockCheck,
    session: Option<WriterSession>,
}

/// The session that a writer has confirmed last.
struct WriterSession {
    id: [u8; 16],
    inbound: Inbound<Message>,
    seen: InboundCounters,
    /// The sequence number that its Welcome announced as the start.
    from: u64,
    /// The last repeated message with an original sequence before `from`.
    latched: u64,
    /// Whether the reader wants every message and the writer stores them.
    reliable: bool,
}

impl WriterSession {
    /// Returns whether a message is new to this reader. Sets the time of a repeated message to that
    /// of its first transmission.
    fn is_new(&mut self, message: &mut Message) -> bool {
        let Some(first) = message.latched else { return true };
        message.timestamp_ns = first.timestamp_ns;
        let new = first.sequence < self.from && first.sequence > self.latched;
        if new {
            self.latched = first.sequence;
        }
        new
    }
}

impl SubscriptionReceiver {
    pub fn new(name: Name, options: SubscribeOptions, queue: mpsc::Sender<Message>, shared: Arc<QueueState>) -> Self {
        Self {
            name,
            reader: Reader::new(name, Backend::selected(), options.limits),
            options,
            queue,
            shared,
            writers: HashMap::new(),
            stalled: VecDeque::new(),
            received: Received::default(),
            seen_drops: [0; DropReason::COUNT],
            timer: None,
            is_touched: false,
        }
    }

    pub fn knows(&self, writer: &Name) -> bool {
        self.writers.contains_key(writer)
    }

    /// Applies a change. Returns the writer whose early frames may be usable now.
    pub fn change(&mut self, now: u64, change: Change) -> Option<Name> {
        match change {
            Change::Authorise { writer, key } => {
                self.reader.authorise(writer, key).ok()?;
                // Even a known writer may have restarted.
                let begun = self.writers.entry(writer).or_default().greeting.begin(now);
                if let Err(error) = begun {
                    tracing::warn!(%error, "a writer could not be asked for its session");
                }
                Some(writer)
            }
            Change::Revoke { writer } => {
                self.reader.revoke(&writer);
                self.writers.remove(&writer);
                self.compare();
                None
            }
            Change::Key { writer, opened: Opened { epoch, key, dropped } } => {
                dropped.into_iter().for_each(|epoch| self.reader.drop_key(&writer, epoch));
                self.reader.set_key(&writer, epoch, key).ok()?;
                Some(writer)
            }
            Change::DropKey { writer, epoch } => {
                self.reader.drop_key(&writer, epoch);
                None
            }
        }
    }

    /// Processes feedback from a writer. Returns whether the writer's early frames may be usable
    /// now.
    pub fn hear(&mut self, now: u64, writer: &Name, feedback: &Feedback) -> bool {
        let Some(known) = self.writers.get_mut(writer) else { return false };
        match feedback {
            Feedback::Welcome { challenge, session, sequence, history, .. } => {
                let Some(rtt) = known.greeting.answered(now, challenge) else { return false };
                if self.reader.confirm_session(writer, *session, *sequence).is_err() {
                    return false;
                }
                if let Some(known) = known.session.as_mut().filter(|known| known.id == *session) {
                    // A repeated Welcome announces the start for a new reader. This reader retains
                    // its position: earlier messages were sent, and those it lacks are missing.
                    known.inbound.heartbeat(now, *sequence, 0);
                } else {
                    let reliable = self.options.wants != Wants::Newest && *history > 0;
                    let options = self.options.inbound(reliable.then_some(*history));
                    let inbound = Inbound::new(self.name, *session, *sequence, rtt, options);
                    let (seen, from) = (InboundCounters::default(), *sequence);
                    known.session = Some(WriterSession { id: *session, inbound, seen, from, latched: 0, reliable });
                    self.compare();
                }
                true
            }
            feedback => {
                if let Some(session) = &mut known.session {
                    session.inbound.feedback(now, feedback);
                }
                false
            }
        }
    }

    /// Processes a writer's answer with its Unix time. Returns the nanoseconds by which its clock
    /// is ahead of this one, if this reader has asked for it.
    pub fn clock_answer(&mut self, now: u64, writer: &Name, challenge: &[u8; 16], unix_ns: u64) -> Option<i64> {
        self.writers.get_mut(writer)?.clock.answered(now, challenge, unix_nanos(), unix_ns)
    }

    /// Processes a frame's payload from a known writer. `marked`: the frame met congestion. The
    /// mark counts if the frame turns out to be of the writer's session.
    pub fn push(
        &mut self,
        now: Timestamps,
        source: Name,
        payload: &[u8],
        marked: bool,
        counters: &Counters,
    ) -> Verdict {
        let Some(writer) = self.writers.get_mut(&source) else { return Verdict::Done };
        let steady = now.steady_ns;
        if let Some(WriterSession { id, inbound, reliable, .. }) = &mut writer.session {
            // The writer retransmits what does not fit. Opening it would count it as delivered.
            let most = inbound.next_sequence().saturating_add(REACH);
            let is_beyond = |id: [u8; 16], sequence| {
                segment_ids(payload).any(|segment| segment.session == id && segment.last() >= sequence)
            };
            if *reliable && (!self.stalled.is_empty() || is_beyond(*id, most)) {
                counters.beyond.add(1);
                return Verdict::Done;
            }
        }
        let before = *self.reader.drops();
        let result = self.reader.push(now, source, payload, &mut self.received);
        let mut verdict = Verdict::Done;
        if let Err(reason @ (DropReason::Unvouched | DropReason::NoKey)) = result {
            if reason == DropReason::Unvouched {
                writer.ask(steady);
            }
            let times = self.reader.drops()[reason as usize] - before[reason as usize];
            // Counted later if it expires.
            self.seen_drops[reason as usize] += times;
            verdict = Verdict::Early(reason, times);
        }
        let received = &mut self.received;
        if received.too_old
            && let Err(error) = writer.clock.too_old(steady)
        {
            tracing::warn!(%error, "a writer could not be asked for its time");
        }
        let Some(WriterSession { id, inbound, .. }) = &mut writer.session else {
            received.clear();
            return verdict;
        };
        // Hop tags do not cover the source between switches. Only what opened shows that the frame
        // is this writer's, and that the mark is for it.
        let mut sessions = received.segments.iter().chain(&received.repeated).map(|segment| segment.session);
        if marked && (sessions.any(|of| of == *id) || received.heartbeats.iter().any(|beat| beat.session == *id)) {
            inbound.congested();
        }
        // Includes repeated segments: after a lost report, the writer must learn that they have
        // arrived. Segments that did not open are unauthenticated and do not count.
        for segment in received.segments.iter().chain(&received.repeated).filter(|segment| segment.session == *id) {
            Segment::of(segment).for_each(|part| _ = inbound.segment(steady, &part));
        }
        for lost in received.lost.iter().filter(|lost| lost.session == *id) {
            if lost.again {
                inbound.forget(steady, lost.sequence);
            } else {
                // Earlier messages are older still.
                let gone = Feedback::Unavailable { name: self.name, session: *id, oldest: lost.sequence + 1 };
                inbound.feedback(steady, &gone);
            }
        }
        for heartbeat in received.heartbeats.iter().filter(|heartbeat| heartbeat.session == *id) {
            inbound.heartbeat(steady, heartbeat.next, heartbeat.oldest);
        }
        for message in received.messages.drain(..) {
            if message.session == *id {
                inbound.complete(steady, message.sequence, message.body.len(), message);
            } else {
                // The message belongs to a session that the writer has left.
                counters.dropped[DropReason::Stale as usize].add(1);
            }
        }
        received.clear();
        verdict
    }

    /// Runs due work: delivers messages to the application, and passes feedback for writers to
    /// `tell`.
    pub fn poll(&mut self, now: u64, counters: &Counters, mut tell: impl FnMut(&Name, Feedback)) {
        self.take_up(counters);
        let Self { name, writers, options, queue, shared, stalled, .. } = self;
        let mut out = Out { options, queue, shared, stalled };
        for (writer, known) in writers.iter_mut() {
            if let Some(challenge) = known.greeting.poll(now) {
                tell(writer, Feedback::Hello { name: *name, challenge, wants: out.options.wants });
            }
            let Some(session) = &mut known.session else { continue };
            if let Some(challenge) = known.clock.poll(now) {
                let (name, session, unix_ns) = (*name, session.id, unix_nanos());
                tell(writer, Feedback::Clock { name, session, challenge, unix_ns });
            }
            while let Some(arrival) = session.inbound.poll(now) {
                match arrival {
                    Arrival::Message(mut message) => {
                        // Counted before delivery, because the recipient of the message may read
                        // the counters.
                        out.shared.counters.add(session.inbound.counters(), &mut session.seen);
                        match session.is_new(&mut message) {
                            true => out.deliver(message, session.reliable, counters),
                            false => _ = out.shared.counters.repeats.fetch_add(1, Ordering::Relaxed),
                        }
                    }
                    Arrival::Feedback(feedback) => tell(writer, feedback),
                }
            }
            out.shared.counters.add(session.inbound.counters(), &mut session.seen);
        }
        if self.reader.next_deadline().is_some_and(|deadline| deadline < now) {
            self.reader.expire(now);
        }
        self.count_drops(counters);
    }

    /// Adds the reports that are due before this time, if a frame to their writer will be sent
    /// anyway.
    pub fn report_early(&mut self, now: u64, before: u64, outgoing: &mut OutgoingFeedback) {
        for (writer, known) in &mut self.writers {
            if outgoing.has(writer)
                && let Some(session) = &mut known.session
                && let Some(report) = session.inbound.report_early(now, before)
            {
                outgoing.push(writer, report);
            }
        }
    }

    /// Returns the time at which [`Self::poll`] has work, without other events.
    pub fn next_wake(&self) -> Option<u64> {
        let of = |known: &KnownWriter| {
            let inbound = known.session.as_ref().and_then(|session| session.inbound.next_wake());
            let clock = known.session.as_ref().and_then(|_| known.clock.next_wake());
            [known.greeting.next_wake(), clock, inbound].into_iter().flatten().min()
        };
        let deadline = self.reader.next_deadline().map(|deadline| deadline.saturating_add(1));
        self.writers.values().filter_map(of).chain(deadline).min()
    }

    /// Returns whether the newest message of a writer is still incomplete.
    pub fn is_amid(&self) -> bool {
        self.writers.values().any(|known| known.session.as_ref().is_some_and(|session| session.inbound.is_amid()))
    }

    /// Delivers messages that waited for space.
    fn take_up(&mut self, counters: &Counters) {
        while let Some(message) = self.stalled.pop_front() {
            let Self { options, queue, shared, stalled, .. } = self;
            if let Some(message) = (Out { options, queue, shared, stalled }).offer(message, counters) {
                self.stalled.push_front(message);
                return;
            }
        }
        self.shared.stalled.store(false, Ordering::Relaxed);
    }

    /// Counts the writers that offer less than the reader requests, and logs the first one.
    fn compare(&self) {
        let lesser = self.writers.iter().filter(|(_, known)| {
            self.options.wants == Wants::Every && known.session.as_ref().is_some_and(|session| !session.reliable)
        });
        let (count, first) = (lesser.clone().count(), lesser.map(|(writer, _)| *writer).next());
        if self.shared.incompatible.swap(count, Ordering::Relaxed) == 0
            && let Some(writer) = first
        {
            tracing::warn!(name = %self.name, %writer, "incompatible QoS: every message is asked for, and the writer \
                                                        offers the newest only (best effort); taking those");
        }
    }

    /// Counts the drops of an early frame that expired.
    pub fn count_early(&self, reason: DropReason, times: u64, counters: &Counters) {
        counters.dropped[reason as usize].add(times);
        self.shared.counters.dropped(reason, times);
    }

    fn count_drops(&mut self, counters: &Counters) {
        let drops = self.reader.drops();
        if *drops != self.seen_drops {
            for (((now, seen), count), reason) in
                drops.iter().zip(&self.seen_drops).zip(&counters.dropped).zip(DropReason::ALL)
            {
                count.add(now - seen);
                self.shared.counters.dropped(*reason, now - seen);
            }
            self.seen_drops = *drops;
        }
    }
}

impl KnownWriter {
    fn ask(&mut self, now: u64) {
        if let Err(error) = self.greeting.ask(now) {
            tracing::warn!(%error, "a writer could not be asked for its session");
        }
    }
}

/// The path of messages to the application.
struct Out<'a> {
    options: &'a SubscribeOptions,
    queue: &'a mpsc::Sender<Message>,
    shared: &'a QueueState,
    stalled: &'a mut VecDeque<Message>,
}

impl Out<'_> {
    fn deliver(&mut self, message: Message, reliable: bool, counters: &Counters) {
        let waits = reliable && !self.stalled.is_empty();
        let refused = if waits { Some(message) } else { self.offer(message, counters) };
        let Some(message) = refused else { return };
        if reliable {
            self.stalled.push_back(message);
            self.shared.stalled.store(true, Ordering::Relaxed);
        } else {
            counters.queue_full.add(1);
            self.shared.counters.queue_full.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Queues a message, or returns it if there is no space. A message that exceeds the whole queue
    /// is accepted if the queue is empty.
    fn offer(&self, message: Message, counters: &Counters) -> Option<Message> {
        let length = message.body.len();
        let queued = self.shared.queued_bytes.load(Ordering::Relaxed);
        if queued > 0 && queued.saturating_add(length) > self.options.queue_bytes {
            return Some(message);
        }
        let Some(message) = self.shared.direct.pass(message, self.queue) else {
            counters.messages_received.add(1);
            return None;
        };
        match self.queue.try_reserve() {
            Ok(place) => {
                // Counted first, because the recipient of the message may read the counters.
                self.shared.queued_bytes.fetch_add(length, Ordering::Relaxed);
                counters.messages_received.add(1);
                place.send(message);
                None
            }
            Err(_) => Some(message),
        }
    }
}

/// How far beyond the first missing message others are accepted: the size of the reader's replay
/// window.
const REACH: u64 = 1024;

#[cfg(test)]
#[path = "../../tests/unit/node/subscription_receiver.rs"]
mod tests;
