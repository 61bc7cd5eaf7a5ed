//! A subscription as the receiving thread has it: the reader, whom it believes, how far each
//! writer's session is, and the queue to the application. What it has to say to writers comes out;
//! the receiving thread sends it.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

use gdp_wire::Name;
use tokio::sync::mpsc;

use super::counters::{Counters, SubscriptionCounters};
use super::greeting::Greeting;
use super::options::SubscribeOptions;
use gdp_core::crypto::Backend;
use gdp_core::identity::VerifyKey;
use gdp_e2e::feedback_wire::{Feedback, Wants};
use gdp_e2e::keys::Opened;
use gdp_e2e::seal::{DropReason, Message, Reader, Received, Timestamps, segment_ids};
use gdp_e2e::transport::{Arrival, Inbound, InboundCounters, Position, Segment};

/// What a reader is to believe.
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
    /// What it seals with.
    Key {
        writer: Name,
        opened: Opened,
    },
    DropKey {
        writer: Name,
        epoch: u32,
    },
}

/// What became of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Used, or dropped and counted.
    Done,
    /// It may be of use later, for this reason and counting for so many drops otherwise.
    Early(DropReason, u64),
}

/// What the application's handle shares with the thread.
#[derive(Default)]
pub struct QueueState {
    pub queued_bytes: AtomicUsize,
    /// Messages of a reliable name wait for room in the queue.
    pub stalled: AtomicBool,
    /// Writers that offer less than the reader asks for.
    pub incompatible: AtomicUsize,
    pub counters: ReadCounters,
}

impl QueueState {
    pub fn counters(&self) -> SubscriptionCounters {
        let counters = &self.counters;
        SubscriptionCounters {
            inbound: counters.get(),
            queue_full: counters.queue_full.load(Ordering::Relaxed),
            repeats: counters.repeats.load(Ordering::Relaxed),
            incompatible_writers: self.incompatible.load(Ordering::Relaxed),
            drops: counters.drops(),
        }
    }
}

/// What became of a name's messages at this reader. Those that the writers began since each was
/// welcomed are the sum of the first four and of what is not dealt with yet.
#[derive(Default)]
pub struct ReadCounters {
    delivered: AtomicU64,
    overtaken: AtomicU64,
    expired: AtomicU64,
    abandoned: AtomicU64,
    duplicates: AtomicU64,
    beyond: AtomicU64,
    /// Of those delivered, what the application did not take in time.
    pub queue_full: AtomicU64,
    /// Of those delivered, latched messages that were known.
    pub repeats: AtomicU64,
    /// Segments and messages that the reader dropped, by [`DropReason`].
    dropped: [AtomicU64; DropReason::COUNT],
}

impl ReadCounters {
    pub fn dropped(&self, reason: DropReason, times: u64) {
        self.dropped[reason as usize].fetch_add(times, Ordering::Relaxed);
    }

    /// Those that are not 0.
    pub fn drops(&self) -> BTreeMap<&'static str, u64> {
        let counts = self.dropped.iter().map(|count| count.load(Ordering::Relaxed));
        DropReason::ALL.iter().map(|reason| reason.label()).zip(counts).filter(|(_, count)| *count > 0).collect()
    }

    pub fn get(&self) -> InboundCounters {
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        InboundCounters {
            delivered: get(&self.delivered),
            overtaken: get(&self.overtaken),
            expired: get(&self.expired),
            abandoned: get(&self.abandoned),
            duplicates: get(&self.duplicates),
            beyond: get(&self.beyond),
        }
    }

    fn add(&self, now: &InboundCounters, seen: &mut InboundCounters) {
        let all = [
            (&self.delivered, now.delivered, seen.delivered),
            (&self.overtaken, now.overtaken, seen.overtaken),
            (&self.expired, now.expired, seen.expired),
            (&self.abandoned, now.abandoned, seen.abandoned),
            (&self.duplicates, now.duplicates, seen.duplicates),
            (&self.beyond, now.beyond, seen.beyond),
        ];
        for (count, now, seen) in all {
            if now != seen {
                count.fetch_add(now - seen, Ordering::Relaxed);
            }
        }
        *seen = *now;
    }
}

/// The thread's side of a subscription.
pub struct SubscriptionReceiver {
    name: Name,
    reader: Reader,
    options: SubscribeOptions,
    queue: mpsc::Sender<Message>,
    shared: Arc<QueueState>,
    writers: HashMap<Name, KnownWriter>,
    /// Of reliable sessions, what the application has no room for yet.
    stalled: VecDeque<Message>,
    /// Empty between calls; keeps its capacity.
    received: Received,
    seen_drops: [u64; DropReason::COUNT],
    /// Where it is among the thread's timers.
    pub timer: Option<u64>,
}

#[derive(Default)]
struct KnownWriter {
    greeting: Greeting,
    session: Option<Session>,
}

/// The one session of a writer that it has vouched for last.
struct Session {
    id: [u8; 16],
    inbound: Inbound<Message>,
    seen: InboundCounters,
    /// What it was told to begin with.
    from: u64,
    /// The last message sent before that which came again.
    latched: u64,
    /// Every message is wanted, and the writer keeps them.
    reliable: bool,
}

impl Session {
    /// Whether a message is new to this reader; its time is that of its first sending.
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
            reader: Reader::new(name, Backend::default(), options.limits),
            options,
            queue,
            shared,
            writers: HashMap::new(),
            stalled: VecDeque::new(),
            received: Received::default(),
            seen_drops: [0; DropReason::COUNT],
            timer: None,
        }
    }

    pub fn knows(&self, writer: &Name) -> bool {
        self.writers.contains_key(writer)
    }

    /// Returns the writer whose early frames may be of use now.
    pub fn change(&mut self, now: u64, change: Change) -> Option<Name> {
        match change {
            Change::Authorise { writer, key } => {
                self.reader.authorise(writer, key).ok()?;
                // It may have begun anew, also if it was known.
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

    /// What the writer says to this reader alone. Returns whether its early frames may be of use
    /// now.
    pub fn hear(&mut self, now: u64, writer: &Name, feedback: &Feedback) -> bool {
        let Some(known) = self.writers.get_mut(writer) else { return false };
        match feedback {
            Feedback::Welcome { challenge, session, sequence, reliable, .. } => {
                let Some(rtt) = known.greeting.answered(now, challenge) else { return false };
                if self.reader.confirm_session(writer, *session, *sequence).is_err() {
                    return false;
                }
                if let Some(known) = known.session.as_mut().filter(|known| known.id == *session) {
                    // It was asked again, and says where a reader begins that knows nothing. This
                    // one knows where it is: what comes before that was sent, and is missed if it
                    // is not here.
                    known.inbound.heartbeat(now, *sequence, 0);
                } else {
                    let reliable = self.options.wants != Wants::Newest && *reliable;
                    let inbound = Inbound::new(self.name, *session, *sequence, rtt, self.options.inbound(reliable));
                    let (seen, from) = (InboundCounters::default(), *sequence);
                    known.session = Some(Session { id: *session, inbound, seen, from, latched: 0, reliable });
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

    /// Takes a frame's payload from a writer it knows. `marked`: the frame met congestion.
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
        if let Some(Session { id, inbound, reliable, .. }) = &mut writer.session {
            if marked {
                inbound.congested();
            }
            // What there is no room for comes again; opened, it would count as delivered.
            let most = inbound.next_sequence().saturating_add(REACH);
            let is_beyond = |id: [u8; 16], sequence| {
                segment_ids(payload).any(|segment| segment.session == id && segment.sequence >= sequence)
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
            // Counted if it is of no use later.
            self.seen_drops[reason as usize] += times;
            verdict = Verdict::Early(reason, times);
        }
        let received = &mut self.received;
        let Some(Session { id, inbound, .. }) = &mut writer.session else {
            received.clear();
            return verdict;
        };
        // Those that are repeated as well: if a report was lost, the writer has to hear that they
        // are here. What did not open is nobody's word, so it counts for nothing.
        for segment in received.segments.iter().chain(&received.repeated).filter(|segment| segment.session == *id) {
            inbound.segment(steady, &as_segment(segment));
        }
        for lost in received.lost.iter().filter(|lost| lost.session == *id) {
            if lost.again {
                inbound.forget(steady, lost.sequence);
            } else {
                // Messages before it are older still.
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
                // Of a session that the writer has left.
                counters.dropped[DropReason::Stale as usize].add(1);
            }
        }
        received.clear();
        verdict
    }

    /// What is due: messages to the application; what is to be said to writers comes out.
    pub fn poll(&mut self, now: u64, counters: &Counters, mut tell: impl FnMut(&Name, &Feedback)) {
        self.take_up(counters);
        let Self { name, writers, options, queue, shared, stalled, .. } = self;
        let mut out = Out { options, queue, shared, stalled };
        for (writer, known) in writers.iter_mut() {
            if let Some(challenge) = known.greeting.poll(now) {
                tell(writer, &Feedback::Hello { name: *name, challenge, wants: out.options.wants });
            }
            let Some(session) = &mut known.session else { continue };
            while let Some(arrival) = session.inbound.poll(now) {
                match arrival {
                    Arrival::Message(mut message) => {
                        // First: who has the message may look.
                        out.shared.counters.add(session.inbound.counters(), &mut session.seen);
                        match session.is_new(&mut message) {
                            true => out.deliver(message, session.reliable, counters),
                            false => _ = out.shared.counters.repeats.fetch_add(1, Ordering::Relaxed),
                        }
                    }
                    Arrival::Feedback(feedback) => tell(writer, &feedback),
                }
            }
            out.shared.counters.add(session.inbound.counters(), &mut session.seen);
        }
        if self.reader.next_deadline().is_some_and(|deadline| deadline < now) {
            self.reader.expire(now);
        }
        self.count_drops(counters);
    }

    /// When [`Self::poll`] has something to do, if nothing else happens.
    pub fn next_wake(&self) -> Option<u64> {
        let of = |known: &KnownWriter| {
            let inbound = known.session.as_ref().and_then(|session| session.inbound.next_wake());
            [known.greeting.next_wake(), inbound].into_iter().flatten().min()
        };
        let deadline = self.reader.next_deadline().map(|deadline| deadline.saturating_add(1));
        self.writers.values().filter_map(of).chain(deadline).min()
    }

    /// Whether the rest of the newest message of a writer is to come.
    pub fn is_amid(&self) -> bool {
        self.writers.values().any(|known| known.session.as_ref().is_some_and(|session| session.inbound.is_amid()))
    }

    /// Brings what waited for room to the application.
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

    /// How many writers offer less than is asked for; of the first of them the log tells.
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

    /// Of a frame that came too early, in vain.
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

/// The way to the application.
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

    /// Returns the message if there is no room for it. One that is larger than all the room is
    /// taken if nothing else is there.
    fn offer(&self, message: Message, counters: &Counters) -> Option<Message> {
        let length = message.body.len();
        let queued = self.shared.queued_bytes.load(Ordering::Relaxed);
        if queued > 0 && queued.saturating_add(length) > self.options.queue_bytes {
            return Some(message);
        }
        match self.queue.try_reserve() {
            Ok(place) => {
                // Counted first: who has the message may look.
                self.shared.queued_bytes.fetch_add(length, Ordering::Relaxed);
                counters.messages_received.add(1);
                place.send(message);
                None
            }
            Err(_) => Some(message),
        }
    }
}

/// How far beyond the first message that is missing others are taken: as far as the reader's replay
/// window remembers.
const REACH: u64 = 1024;

fn as_segment(id: &gdp_e2e::seal::SegmentId) -> Segment {
    let position = Position { sequence: id.sequence, index: id.index };
    Segment { position, cut: id.cut, total: id.count.saturating_add(1), bytes: id.len }
}

#[cfg(test)]
#[path = "../../tests/unit/node/subscription_receiver.rs"]
mod tests;
