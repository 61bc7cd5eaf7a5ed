//! The reader's state of one session of a writer: missing segments, requests, delivery order,
//! messages given up, and feedback to the writer.

pub use crate::transport::arrival::{Arrival, InboundCounters, InboundOptions, Order, Segment};
use std::collections::VecDeque;

use gdp_wire::Name;

use super::reordering::{LEAST_TOLERANCE, ReorderingWindow};
use super::reports::{Reports, report_interval};
use super::slot::{Body, Slot};
use super::{MS, Position};
use crate::feedback_wire::{Feedback, MAX_MISSING, MAX_SEQUENCE};

/// Timers that are looked at later than this say nothing: this thread had no processor, and the
/// writer may have had none either. They start once more.
const AWAY: u64 = MS;

/// Maximum interval between repeated requests.
const SLOWEST_ASKING: u64 = 1_000 * MS;

const LONGEST_RTT: u64 = 1_000 * MS;

/// The state of a session. `M` is a message as delivered.
#[derive(Debug)]
pub struct Inbound<M> {
    name: Name,
    session: [u8; 16],
    options: InboundOptions,
    /// The first sequence that is not settled, that is, neither delivered nor given up.
    next: u64,
    /// Slots of the known messages from `next` on.
    slots: VecDeque<Slot<M>>,
    /// Signed data proves that all messages before this one exist.
    exists: u64,
    /// The last received segment, in the order of sending, and its arrival time.
    highest: Position,
    highest_at: u64,
    /// Bytes charged to the slots.
    bytes: usize,
    rtt: u64,
    reordering: ReorderingWindow,
    /// Time from a request to its repair: a round trip plus the delay of the writer's budget and
    /// queues.
    repair_time: u64,
    /// At this time, segments missing up to this position are due for a request.
    mark: Option<(u64, Position)>,
    /// The mark, or the time of the last segment, was moved because this thread was away.
    is_mark_moved: bool,
    is_idle_moved: bool,
    /// Segments missing up to this position are requested.
    due: Position,
    received_at: u64,
    ask_at: u64,
    reports: Reports,
    ready: VecDeque<M>,
    counters: InboundCounters,
}

impl<M> Inbound<M> {
    /// Starts a session. `from` is the first sequence according to the writer, `rtt` the time until
    /// the writer's answer.
    pub fn new(name: Name, session: [u8; 16], from: u64, rtt: u64, options: InboundOptions) -> Self {
        let from = from.clamp(1, MAX_SEQUENCE);
        Self {
            name,
            session,
            options,
            next: from,
            slots: VecDeque::new(),
            exists: from,
            highest: Position { sequence: 0, index: 0 },
            highest_at: 0,
            bytes: 0,
            rtt: rtt.clamp(MS, LONGEST_RTT),
            reordering: ReorderingWindow::default(),
            repair_time: rtt.clamp(MS, LONGEST_RTT),
            mark: None,
            is_mark_moved: false,
            is_idle_moved: false,
            due: Position { sequence: 0, index: 0 },
            received_at: 0,
            ask_at: u64::MAX,
            reports: Reports::new(from),
            ready: VecDeque::new(),
            counters: InboundCounters::default(),
        }
    }

    /// Counts a frame of this session with a congestion mark.
    pub fn congested(&mut self) {
        self.reports.on_mark();
    }

    /// Processes a segment. Returns false if the segment is useless: its message is settled, it was
    /// already received, or there is no room for it. The caller must then spend no memory on it.
    pub fn segment(&mut self, now: u64, segment: &Segment) -> bool {
        let Segment { position, cut, total, bytes } = *segment;
        if position.sequence > MAX_SEQUENCE || position.index >= total {
            return false;
        }
        if position.sequence < self.next {
            self.on_duplicate(now, position, bytes);
            return false;
        }
        if self.slot_for(now, position.sequence).is_none() || !self.make_room(position.sequence, total) {
            self.counters.beyond += 1;
            self.expedite_report(now);
            return false;
        }
        let index = (position.sequence - self.next) as usize;
        let slot = &mut self.slots[index];
        let answered = slot.answered_in(now, position.index);
        let before = slot.total();
        if !slot.add(cut, position.index, total) {
            self.on_duplicate(now, position, bytes);
            return false;
        }
        self.bytes = self.bytes + Slot::<M>::cost(slot.total()) - Slot::<M>::cost(before);
        if let Some(took) = answered {
            self.reordering.on_answer(position);
            self.repair_time = ((7 * self.repair_time + took) / 8).clamp(self.rtt, LONGEST_RTT);
        }
        self.reports.on_segment(now, position, bytes);
        (self.received_at, self.is_idle_moved) = (now, false);
        if position > self.highest {
            (self.highest, self.highest_at) = (position, now);
        }
        self.reordering.look(now);
        if self.mark.is_none() {
            self.mark = Some((now + self.reordering.tolerance(self.rtt), self.highest));
        }
        self.plan_report(now);
        true
    }

    /// Processes a complete and verified message of `bytes` bytes of body. Only verified messages
    /// advance the settled sequence, because any holder of the session's key can forge segments.
    pub fn complete(&mut self, now: u64, sequence: u64, bytes: usize, message: M) {
        if sequence < self.next || sequence > MAX_SEQUENCE {
            return;
        }
        self.exists = self.exists.max(sequence + 1);
        if self.options.order == Order::Newest && sequence - self.next >= self.options.messages.max(1) as u64 {
            self.deal_with(sequence - 1, Skipped::Overtaken);
        }
        if self.slot_for(now, sequence).is_none() {
            return;
        }
        let late = self.options.deadline;
        let slot = &mut self.slots[(sequence - self.next) as usize];
        if !slot.is_open() {
            return;
        }
        if self.options.order == Order::Newest && slot.known_at.saturating_add(late) <= now {
            self.deal_with(sequence, Skipped::Late);
            self.plan_report(now);
            return;
        }
        slot.body = Body::Complete(message, bytes);
        self.bytes += bytes;
        match self.options.order {
            Order::Newest => self.deal_with(sequence, Skipped::Overtaken),
            Order::Every => {
                self.deliver();
                while self.bytes > self.options.bytes && !self.slots.is_empty() {
                    self.give_up_first_gap();
                }
            }
        }
        self.plan_report(now);
    }

    /// Discards the received segments of a message without settling it. All its segments are needed
    /// again.
    pub fn forget(&mut self, now: u64, sequence: u64) {
        let index = sequence.wrapping_sub(self.next);
        let Some(slot) = usize::try_from(index).ok().and_then(|index| self.slots.get_mut(index)) else { return };
        if slot.is_open() {
            self.bytes -= Slot::<M>::cost(slot.total()) - Slot::<M>::cost(0);
            slot.clear();
            self.plan_ask(now);
        }
    }

    /// Processes a signed heartbeat of the writer. `next` is the sequence of the next message, and
    /// messages before `oldest` cannot be repaired.
    pub fn heartbeat(&mut self, now: u64, next: u64, oldest: u64) {
        let next = next.min(MAX_SEQUENCE);
        if self.options.order == Order::Every {
            self.set_unavailable(oldest.min(next));
        }
        self.exists = self.exists.max(next);
        if self.options.order == Order::Every && next > self.next {
            self.slot_for(now, next - 1);
            // All of these messages were sent, so nothing is in flight any more.
            self.due = self.due.max(Position { sequence: next - 1, index: u32::MAX });
            self.plan_ask(now);
        }
        self.expedite_report(now);
    }

    /// Processes feedback of the writer to this reader.
    pub fn feedback(&mut self, now: u64, feedback: &Feedback) {
        if let Feedback::Unavailable { session, oldest, .. } = feedback
            && *session == self.session
        {
            self.set_unavailable((*oldest).min(MAX_SEQUENCE));
            self.expedite_report(now);
        }
    }

    /// Returns the next output. The caller must poll until `None`, after every other call and at
    /// [`Self::next_wake`].
    pub fn poll(&mut self, now: u64) -> Option<Arrival<M>> {
        self.expire(now);
        if let Some(message) = self.ready.pop_front() {
            return Some(Arrival::Message(message));
        }
        if self.slots.is_empty() {
            // Nothing is missing, and nobody waits for the mark.
            (self.mark, self.is_mark_moved) = (None, false);
        }
        if let Some((at, position)) = self.mark
            && at <= now
        {
            let next_mark = now + self.reordering.tolerance(self.rtt);
            self.is_mark_moved = !self.is_mark_moved && now > at + AWAY;
            if self.is_mark_moved {
                self.mark = Some((next_mark, position));
            } else {
                self.due = self.due.max(position);
                self.mark = (self.highest > position).then_some((next_mark, self.highest));
                self.plan_ask(now);
            }
        }
        // The writer stopped in the middle of a message, or its last segments were lost.
        if !self.slots.is_empty() && now >= self.idle_at() && self.due < self.highest_known() {
            if !self.is_idle_moved && now > self.idle_at() + AWAY {
                (self.received_at, self.is_idle_moved) = (now, true);
            } else {
                self.due = self.highest_known();
                self.plan_ask(now);
            }
        }
        if self.ask_at <= now {
            let nack = self.ask(now);
            if nack.is_some() {
                return nack.map(Arrival::Feedback);
            }
        }
        self.report_early(now, now).map(Arrival::Feedback)
    }

    /// Returns the report if it is due before this time, for a frame that is sent anyway.
    pub fn report_early(&mut self, now: u64, before: u64) -> Option<Feedback> {
        let due = self.reports.due_at() <= before;
        due.then(|| self.reports.report(now, self.name, self.session, self.highest.sequence, self.next))
    }

    /// Returns the time when [`Self::poll`] will return an output, if no other call precedes it.
    pub fn next_wake(&self) -> Option<u64> {
        let ready = (!self.ready.is_empty()).then_some(0);
        let mark = self.mark.map(|(at, _)| at);
        let idle = (!self.slots.is_empty() && self.due < self.highest_known()).then(|| self.idle_at());
        let timers = [self.ask_at, self.reports.due_at()].into_iter().filter(|at| *at < u64::MAX);
        [ready, mark, idle, self.deadline()].into_iter().flatten().chain(timers).min()
    }

    /// Sets a round-trip time that was measured otherwise.
    pub fn set_rtt(&mut self, rtt: u64) {
        self.rtt = rtt.clamp(MS, LONGEST_RTT);
        self.repair_time = self.repair_time.max(self.rtt);
    }

    pub fn counters(&self) -> &InboundCounters {
        &self.counters
    }

    /// Returns the first sequence that is not settled.
    pub fn next_sequence(&self) -> u64 {
        self.next
    }

    /// Returns whether the newest message is partially received.
    pub fn is_amid(&self) -> bool {
        self.slots.back().is_some_and(|slot| slot.is_open() && slot.total() > 0)
    }

    /// Returns the bytes of waiting messages and of the state of incomplete ones.
    pub fn memory(&self) -> usize {
        self.bytes
    }

    fn set_unavailable(&mut self, oldest: u64) {
        if oldest > self.next {
            self.deal_with(oldest - 1, Skipped::Abandoned);
            self.deliver();
        }
    }

    /// Processes a segment that was already received.
    fn on_duplicate(&mut self, now: u64, position: Position, bytes: usize) {
        self.counters.duplicates += 1;
        if self.reordering.on_duplicate(now, position, self.rtt) {
            self.reports.on_needless(bytes);
        }
        // If a report was lost, the writer must learn that the segment has arrived.
        self.expedite_report(now);
    }

    /// Returns the time when nothing is in flight any more, even if the writer had to wait for a
    /// report.
    fn idle_at(&self) -> u64 {
        self.received_at + self.rtt + self.rtt / 2 + report_interval(self.rtt) + self.reordering.extra()
    }

    /// Returns the end of the newest message with a received segment.
    fn highest_known(&self) -> Position {
        Position { sequence: self.highest.sequence, index: u32::MAX }
    }

    /// Returns the time when the first unsettled message is given up.
    fn deadline(&self) -> Option<u64> {
        // A message known only from unverified segments may not exist.
        let slot = self.slots.front().filter(|slot| slot.is_open() && self.next < self.exists)?;
        Some(slot.known_at.saturating_add(self.options.deadline))
    }

    fn expire(&mut self, now: u64) {
        while self.deadline().is_some_and(|deadline| deadline <= now) {
            self.deal_with(self.next, Skipped::Late);
            self.deliver();
            self.plan_report(now);
        }
    }

    /// Creates the slots up to a message from `next` on. Returns `None` if the message is beyond
    /// the limit of outstanding ones.
    fn slot_for(&mut self, now: u64, sequence: u64) -> Option<()> {
        let index = sequence - self.next;
        let most = self.options.messages.max(1) as u64;
        let wanted = index.min(most - 1) as usize + 1;
        while self.slots.len() < wanted {
            self.slots.push_back(Slot::new(now));
            self.bytes += Slot::<M>::cost(0);
        }
        (index < most).then_some(())
    }

    /// Returns whether the state of a message of `total` segments has room.
    fn make_room(&mut self, sequence: u64, total: u32) -> bool {
        let index = (sequence - self.next) as usize;
        let slot = &self.slots[index];
        slot.total() == total || self.bytes + Slot::<M>::cost(total) <= self.options.bytes
    }

    /// Settles all messages up to this sequence. Counts missing ones under `why`.
    fn deal_with(&mut self, sequence: u64, why: Skipped) {
        while self.next <= sequence {
            let Some(slot) = self.slots.pop_front() else {
                *self.counter(why) += sequence + 1 - self.next;
                self.next = sequence + 1;
                break;
            };
            self.next += 1;
            self.bytes -= Slot::<M>::cost(slot.total());
            match slot.body {
                Body::Complete(message, bytes) => {
                    self.bytes -= bytes;
                    self.counters.delivered += 1;
                    self.ready.push_back(message);
                }
                Body::Open => *self.counter(why) += 1,
            }
        }
    }

    fn counter(&mut self, why: Skipped) -> &mut u64 {
        match why {
            Skipped::Overtaken => &mut self.counters.overtaken,
            Skipped::Late => &mut self.counters.expired,
            Skipped::Abandoned => &mut self.counters.abandoned,
        }
    }

    /// Delivers the complete messages without a gap before them.
    fn deliver(&mut self) {
        let complete = self.slots.iter().take_while(|slot| !slot.is_open()).count() as u64;
        if complete > 0 {
            self.deal_with(self.next + complete - 1, Skipped::Abandoned);
        }
    }

    fn give_up_first_gap(&mut self) {
        let gap = self.slots.iter().take_while(|slot| slot.is_open()).count() as u64;
        if gap > 0 {
            self.deal_with(self.next + gap - 1, Skipped::Abandoned);
        }
        self.deliver();
    }

    /// Returns the requests that are due, in one message of bounded size.
    fn ask(&mut self, now: u64) -> Option<Feedback> {
        self.slot_up_to_existing(now);
        let mut missing = Vec::new();
        let (wait, due) = (self.repair_time + self.repair_time / 4, self.due);
        for (sequence, slot) in (self.next..=due.sequence).zip(&mut self.slots) {
            if missing.len() == MAX_MISSING {
                break;
            }
            if slot.is_open() && slot.known_at.saturating_add(self.options.deadline) > now {
                if slot.ask_again_at(wait, SLOWEST_ASKING).is_some_and(|at| at <= now) {
                    slot.forget_asked();
                }
                let end = if sequence == due.sequence { due.index } else { u32::MAX };
                slot.ask(now, sequence, end, MAX_MISSING, &mut missing);
            }
        }
        self.ask_at = u64::MAX;
        self.plan_ask(now + LEAST_TOLERANCE);
        let (name, session, highest) = (self.name, self.session, self.highest);
        let waited_us = u32::try_from(now.saturating_sub(self.highest_at) / 1000).unwrap_or(u32::MAX);
        let (highest, highest_index) = (highest.sequence, highest.index);
        let nack = Feedback::Nack { name, session, highest, highest_index, waited_us, missing };
        matches!(&nack, Feedback::Nack { missing, .. } if !missing.is_empty()).then_some(nack)
    }

    /// Creates slots for messages that exist but have no received segment.
    fn slot_up_to_existing(&mut self, now: u64) {
        if self.options.order == Order::Every && self.exists > self.next {
            self.slot_for(now, self.exists - 1);
        }
    }

    /// Schedules the next request, not before `from`.
    fn plan_ask(&mut self, from: u64) {
        let (wait, due) = (self.repair_time + self.repair_time / 4, self.due);
        let fresh = |slot: &Slot<M>| slot.is_open() && slot.known_at.saturating_add(self.options.deadline) > from;
        let open = (self.next..=due.sequence).zip(&self.slots).filter(|(_, slot)| fresh(slot));
        let times = open.filter_map(|(sequence, slot)| {
            let end = if sequence == due.sequence { due.index } else { u32::MAX };
            if slot.has_wanted(end) {
                Some(from)
            } else {
                slot.ask_again_at(wait, SLOWEST_ASKING).map(|at| at.max(from))
            }
        });
        if let Some(at) = times.min() {
            self.ask_at = self.ask_at.min(at);
        }
    }

    fn plan_report(&mut self, now: u64) {
        self.reports.plan(now, self.rtt, self.next, self.options.report_after);
    }

    fn expedite_report(&mut self, now: u64) {
        self.reports.expedite();
        self.plan_report(now);
    }
}

/// The reason that a message is settled without delivery.
#[derive(Clone, Copy)]
enum Skipped {
    Overtaken,
    Late,
    Abandoned,
}
