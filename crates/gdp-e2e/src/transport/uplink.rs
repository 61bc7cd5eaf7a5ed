//! The scheduler of all topics on one link: by class, fairly within a class, and within the link's
//! budget.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use gdp_wire::Name;

use super::history::TopicCounters;
use super::meter::{Meter, nanoseconds};
use super::outbox::Chosen;
use super::topic::{TopicOptions, TopicState, TopicTurn};
use super::{FRAME_HEADER, Sealed};
use crate::feedback_wire::Feedback;

const CLASSES: usize = 8;

/// Minimum share of each waiting class: one 32nd of the bytes that other classes send.
const FLOOR_SHARE: u64 = 32;
/// Maximum share that a class can accumulate, in bytes.
const MOST_OWED: u64 = 64 << 10;

/// Maximum bytes of waiting copies for this link, per class.
const MOST_COPIES: u64 = 256 << 10;

/// Burst of the budget: two large frames.
const BURST_BYTES: u64 = 3000;

#[derive(Clone, Copy, Debug)]
pub struct UplinkOptions {
    /// Payload of a frame that the path currently supports, in bytes.
    pub max_payload: usize,
    /// Bytes a second, including frame headers. `None`: limited by the readers' paths only.
    pub budget: Option<u64>,
}

/// Identifies a topic of an uplink. The id of a closed topic stays invalid when its slot is reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicId {
    index: u32,
    generation: u32,
}

/// The reason that a message was refused. Returns the message to the caller.
#[derive(Debug)]
pub enum Full {
    /// The publisher must wait for [`Output::Room`] of the topic.
    Wait(Sealed),
    /// The topic is closed, or the message's sequence does not follow the previous ones.
    Refused(Sealed),
}

/// An action for the caller.
#[derive(Clone, Debug)]
pub enum Output {
    Send(Transmit),
    /// Seal these messages again, for [`Uplink::max_payload_of`] the topic, and pass them to
    /// [`Uplink::resealed`].
    Reseal {
        topic: TopicId,
        message: Arc<Sealed>,
    },
    /// Send a signed message to all readers: `next` is the sequence of the next message, and
    /// messages before `oldest` cannot be repaired.
    Heartbeat {
        topic: TopicId,
        next: u64,
        oldest: u64,
    },
    /// Inform this reader that messages before `oldest` cannot be repaired.
    Unavailable {
        topic: TopicId,
        reader: Name,
        oldest: u64,
    },
    /// A publisher that waits for room or for its turn may retry.
    Room {
        topic: TopicId,
    },
}

/// A frame: one payload, or several small ones of different messages.
#[derive(Clone, Debug)]
pub struct Transmit {
    pub name: Name,
    pub class: u8,
    /// Whether the frame must also be passed to [`Uplink::copy`] of the second uplink.
    pub doubled: bool,
    first: Chosen,
    more: Vec<Chosen>,
    bytes: usize,
}

impl Transmit {
    /// Returns the parts of the frame's payload, in this order.
    pub fn payloads(&self) -> impl Iterator<Item = &[u8]> {
        self.parts().map(|part| part.message.payload(part.frame))
    }

    /// Returns the length of the frame's payload.
    pub fn payload_len(&self) -> usize {
        self.bytes
    }

    pub(super) fn parts(&self) -> impl Iterator<Item = &Chosen> {
        std::iter::once(&self.first).chain(&self.more)
    }

    fn wire_bytes(&self) -> u64 {
        self.bytes as u64 + FRAME_HEADER
    }
}

/// The frames that leave by one link.
#[derive(Debug)]
pub struct Uplink {
    options: UplinkOptions,
    budget: Meter,
    slots: Vec<Slot>,
    free: Vec<u32>,
    /// Topics that may send, by class, each with the time since when.
    ready: [VecDeque<(TopicId, u64)>; CLASSES],
    /// Copies of another uplink's frames and their bytes, by class.
    copies: [(VecDeque<Transmit>, u64); CLASSES],
    copies_dropped: u64,
    /// Bytes that a class may send before higher classes.
    owed: [u64; CLASSES],
    timers: BTreeSet<(u64, TopicId)>,
    outputs: VecDeque<Output>,
}

#[derive(Debug, Default)]
struct Slot {
    generation: u32,
    topic: Option<Box<TopicState>>,
    /// The entry of the topic in the timers.
    timer: Option<u64>,
    is_ready: bool,
}

impl Uplink {
    pub fn new(now: u64, options: UplinkOptions) -> Self {
        Self {
            options,
            budget: Meter::new(now),
            slots: Vec::new(),
            free: Vec::new(),
            ready: Default::default(),
            copies: Default::default(),
            copies_dropped: 0,
            owed: [0; CLASSES],
            timers: BTreeSet::new(),
            outputs: VecDeque::new(),
        }
    }

    /// Opens a topic for the messages of one writer's session to `name`. Nothing is sent until a
    /// reader joins.
    pub fn open(&mut self, now: u64, name: Name, session: [u8; 16], options: TopicOptions) -> TopicId {
        let index = self.free.pop().unwrap_or_else(|| {
            self.slots.push(Slot::default());
            self.slots.len() as u32 - 1
        });
        let slot = &mut self.slots[index as usize];
        slot.topic = Some(Box::new(TopicState::new(now, name, session, options)));
        TopicId { index, generation: slot.generation }
    }

    /// Closes a topic and drops its waiting messages.
    pub fn close(&mut self, topic: TopicId) {
        let Some(slot) = self.slot(topic) else { return };
        let timer = slot.timer.take();
        (slot.topic, slot.is_ready) = (None, false);
        slot.generation = slot.generation.wrapping_add(1);
        if let Some(at) = timer {
            self.timers.remove(&(at, topic));
        }
        self.ready.iter_mut().for_each(|ready| ready.retain(|(of, _)| *of != topic));
        self.outputs.retain(|output| match output {
            Output::Reseal { topic: of, .. }
            | Output::Heartbeat { topic: of, .. }
            | Output::Unavailable { topic: of, .. }
            | Output::Room { topic: of } => *of != topic,
            Output::Send(_) => true,
        });
        self.free.push(topic.index);
    }

    /// Accepts a message. Sequences must ascend over all messages of a topic.
    pub fn push(&mut self, now: u64, topic: TopicId, message: Sealed) -> Result<(), Full> {
        let Some(state) = self.topic(topic) else { return Err(Full::Refused(message)) };
        if message.first() <= state.outbox.last() {
            return Err(Full::Refused(message));
        }
        let result = state.push(now, message).map_err(Full::Wait);
        self.settle(now, topic);
        result
    }

    /// Returns whether a new message would directly follow the current one, without replacing or
    /// waiting for another. If not, [`Output::Room`] follows when it would.
    pub fn has_turn(&mut self, topic: TopicId) -> bool {
        self.topic(topic).is_none_or(TopicState::has_turn)
    }

    /// Adds an authorised reader, which gets all messages pushed from now on. Returns the first
    /// sequence for this reader. Returns `None` if the topic is closed, or has too many readers to
    /// track this one.
    pub fn join(&mut self, now: u64, topic: TopicId, reader: Name) -> Option<u64> {
        let state = self.topic(topic)?;
        let next = state.outbox.last() + 1;
        let joined = state.join(now, reader);
        self.settle(now, topic);
        joined.then_some(next)
    }

    /// Starts the state of a reader anew that has restarted. It gets the messages from sequence
    /// `from` (at least 1) on. Does nothing if the reader did not join.
    pub fn restart(&mut self, now: u64, topic: TopicId, reader: &Name, from: u64) {
        let Some(state) = self.topic(topic) else { return };
        if state.restart(now, reader, from) {
            self.outputs.push_back(Output::Room { topic });
        }
        self.settle(now, topic);
    }

    /// Removes a reader that has left or is no longer authorised.
    pub fn leave(&mut self, now: u64, topic: TopicId, reader: &Name) {
        let Some(state) = self.topic(topic) else { return };
        if state.leave(reader) {
            self.outputs.push_back(Output::Room { topic });
        }
        self.settle(now, topic);
    }

    /// Processes feedback of a reader, which was opened with the pair key of reader and writer.
    /// Ignores kinds and sessions that do not concern the topic, and readers that did not join.
    pub fn feedback(&mut self, now: u64, topic: TopicId, reader: Name, feedback: &Feedback) {
        let Some(state) = self.topic(topic) else { return };
        let (gone, room) = state.on_feedback(now, &reader, feedback);
        if let Some(oldest) = gone {
            let of_reader = |output: &Output| match output {
                Output::Unavailable { topic: of, reader: to, .. } => (*of, *to) == (topic, reader),
                _ => false,
            };
            self.outputs.retain(|output| !of_reader(output));
            self.outputs.push_back(Output::Unavailable { topic, reader, oldest });
        }
        if room {
            self.outputs.push_back(Output::Room { topic });
        }
        self.settle(now, topic);
    }

    /// Changes the maximum payload of frames. Messages that were cut for larger frames are resealed
    /// when their turn comes.
    pub fn set_max_payload(&mut self, now: u64, max_payload: usize) {
        self.options.max_payload = max_payload;
        for index in 0..self.slots.len() {
            let topic = TopicId { index: index as u32, generation: self.slots[index].generation };
            self.settle(now, topic);
        }
    }

    /// Changes the budget, because the link has changed.
    pub fn set_budget(&mut self, budget: Option<u64>) {
        self.options.budget = budget;
    }

    /// Accepts the answer to [`Output::Reseal`].
    pub fn resealed(&mut self, now: u64, topic: TopicId, message: Sealed) {
        if let Some(state) = self.topic(topic) {
            state.outbox.resealed(message);
            self.settle(now, topic);
        }
    }

    /// Accepts the other answer to [`Output::Reseal`]: these messages cannot be sealed again and
    /// are lost.
    pub fn abandon(&mut self, now: u64, topic: TopicId, message: &Sealed) {
        if let Some(state) = self.topic(topic) {
            state.outbox.abandon(message.first());
            self.settle(now, topic);
        }
    }

    /// Returns the payload of a frame that the link currently supports, in bytes.
    pub fn max_payload(&self) -> usize {
        self.options.max_payload
    }

    /// Returns the payload of a frame to seal a topic's messages for, in bytes. It is smaller than
    /// that of the link if large frames are lost on the path to a reader.
    pub fn max_payload_of(&mut self, now: u64, topic: TopicId) -> usize {
        let of_link = self.options.max_payload;
        self.topic(topic).map_or(of_link, |state| state.max_payload(now, of_link))
    }

    /// Queues a copy of a frame that another uplink sends. Drops the copy if it is too large for
    /// the link, or if too many copies wait for the budget.
    pub fn copy(&mut self, transmit: Transmit) {
        let (queue, bytes) = &mut self.copies[usize::from(transmit.class)];
        if *bytes + transmit.wire_bytes() > MOST_COPIES || transmit.bytes > self.options.max_payload {
            self.copies_dropped += 1;
            return;
        }
        *bytes += transmit.wire_bytes();
        queue.push_back(transmit);
    }

    /// Drops all waiting copies.
    pub fn drop_copies(&mut self) {
        for (queue, bytes) in &mut self.copies {
            self.copies_dropped += queue.len() as u64;
            (*queue, *bytes) = Default::default();
        }
    }

    /// Returns the number of copies that were dropped.
    pub fn copies_dropped(&self) -> u64 {
        self.copies_dropped
    }

    pub fn counters(&self, topic: TopicId) -> Option<TopicCounters> {
        let slot = self.slots.get(topic.index as usize).filter(|slot| slot.generation == topic.generation)?;
        slot.topic.as_ref().map(|state| *state.outbox.counters())
    }

    /// Returns the number of unsent messages, and the number of unacknowledged messages for each
    /// live reader that lacks some. Returns `None` if the topic is closed.
    pub fn unfinished(&self, topic: TopicId) -> Option<(u64, Vec<(Name, u64)>)> {
        let slot = self.slots.get(topic.index as usize).filter(|slot| slot.generation == topic.generation)?;
        slot.topic.as_ref().map(|state| state.unfinished())
    }

    /// Returns the next action. The caller must poll until `None`, after every other call and at
    /// [`Self::next_wake`].
    pub fn poll(&mut self, now: u64) -> Option<Output> {
        loop {
            if let Some(output) = self.outputs.pop_front() {
                return Some(output);
            }
            match self.timers.first() {
                Some(&(at, topic)) if at <= now => self.on_timer(now, topic),
                _ => return self.transmit(now).map(Output::Send),
            }
        }
    }

    /// Returns the time when [`Self::poll`] will return an action, if no other call precedes it.
    pub fn next_wake(&self) -> Option<u64> {
        let waiting =
            self.ready.iter().any(|ready| !ready.is_empty()) || self.copies.iter().any(|(queue, _)| !queue.is_empty());
        let frame = waiting.then(|| self.budget_at());
        let output = (!self.outputs.is_empty()).then_some(0);
        let timer = self.timers.first().map(|(at, _)| *at);
        [frame, output, timer].into_iter().flatten().min()
    }

    fn transmit(&mut self, now: u64) -> Option<Transmit> {
        while self.budget_at() <= now {
            let class = self.next_class()?;
            let transmit = match self.copies[class].0.pop_front() {
                Some(copy) => {
                    self.copies[class].1 -= copy.wire_bytes();
                    Some(copy)
                }
                None => self.next_of(now, class),
            };
            if let Some(transmit) = transmit {
                self.charge(now, class, transmit.wire_bytes());
                return Some(transmit);
            }
        }
        None
    }

    /// Returns a class with an accumulated share, or else the highest waiting class.
    fn next_class(&self) -> Option<usize> {
        let waits = |class: &usize| !self.ready[*class].is_empty() || !self.copies[*class].0.is_empty();
        let owed = (0..CLASSES).rev().filter(waits).find(|class| self.owed[*class] >= BURST_BYTES / 2);
        owed.or_else(|| (0..CLASSES).rev().find(waits))
    }

    /// Returns a frame of the next topic, filled with further payloads of the topic.
    fn next_of(&mut self, now: u64, class: usize) -> Option<Transmit> {
        let (topic, since) = self.ready[class].pop_front()?;
        let UplinkOptions { max_payload, budget } = self.options;
        let slot = self.slot(topic)?;
        slot.is_ready = false;
        let state = slot.topic.as_mut()?;
        if budget.is_some() {
            state.forget_lateness();
        }
        let (name, doubled) = (state.name, state.options.doubled);
        let max_payload = state.max_payload(now, max_payload);
        let transmit = state.take(now, max_payload, max_payload, now - since).map(|first| {
            let mut bytes = first.message.len(first.frame);
            let mut more = Vec::new();
            while let Some(next) = state.take(now, max_payload, max_payload - bytes, 0) {
                bytes += next.message.len(next.frame);
                more.push(next);
            }
            Transmit { name, class: class as u8, doubled, first, more, bytes }
        });
        self.settle(now, topic);
        transmit
    }

    fn charge(&mut self, now: u64, class: usize, bytes: u64) {
        if let Some(budget) = self.options.budget {
            self.budget.take(now, bytes, budget);
        }
        self.owed[class] = self.owed[class].saturating_sub(bytes);
        for other in 0..CLASSES {
            let waits = !self.ready[other].is_empty() || !self.copies[other].0.is_empty();
            if other != class {
                let more = if waits { self.owed[other] + bytes / FLOOR_SHARE } else { 0 };
                self.owed[other] = more.min(MOST_OWED);
            }
        }
    }

    fn budget_at(&self) -> u64 {
        self.options.budget.map_or(0, |budget| self.budget.ready_at(nanoseconds(BURST_BYTES, budget)))
    }

    fn on_timer(&mut self, now: u64, topic: TopicId) {
        let Some(state) = self.topic(topic) else { return };
        let due = state.on_timer(now);
        if let Some((next, oldest)) = due.heartbeat {
            self.outputs.push_back(Output::Heartbeat { topic, next, oldest });
        }
        if due.room {
            self.outputs.push_back(Output::Room { topic });
        }
        self.settle(now, topic);
    }

    /// Updates the queues and timers of a topic after a change.
    fn settle(&mut self, now: u64, topic: TopicId) {
        let max_payload = self.options.max_payload;
        let Some(slot) = self.slot(topic) else { return };
        let Some(state) = &mut slot.topic else { return };
        let class = usize::from(state.options.class);
        let TopicTurn { may_send, at } = state.turn(now, state.max_payload(now, max_payload));
        let has_turn = state.take_turn();
        let mut resealing = Vec::new();
        while let Some(message) = state.outbox.next_to_reseal() {
            resealing.push(message);
        }
        let timer = (at < u64::MAX).then_some(at);
        let begins = may_send && !slot.is_ready;
        slot.is_ready |= begins;
        let old = std::mem::replace(&mut slot.timer, timer);
        if old != timer {
            old.map(|at| self.timers.remove(&(at, topic)));
            timer.map(|at| self.timers.insert((at, topic)));
        }
        if begins {
            self.ready[class].push_back((topic, now));
        }
        self.outputs.extend(resealing.into_iter().map(|message| Output::Reseal { topic, message }));
        if has_turn {
            self.outputs.push_back(Output::Room { topic });
        }
    }

    fn slot(&mut self, topic: TopicId) -> Option<&mut Slot> {
        self.slots.get_mut(topic.index as usize).filter(|slot| slot.generation == topic.generation)
    }

    fn topic(&mut self, topic: TopicId) -> Option<&mut TopicState> {
        self.slot(topic)?.topic.as_deref_mut()
    }
}
