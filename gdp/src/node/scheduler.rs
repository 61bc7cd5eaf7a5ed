//! The middle stage of the send path: the queues of all topics, scheduled for the main link, and
//! the sending thread's next work.
//!
//! It uses the links below it, and knows no stage above.

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use gdp_wire::{Header, Name, SMALLEST_PATH};
use parking_lot::{Condvar, MappedMutexGuard, Mutex, MutexGuard};

use super::clock::Clock;
use super::links::Links;
use super::message_batch::Turns;
use super::stamps::Stamps;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::transport::{Output, TopicId, Transmit, Uplink, UplinkOptions};
use gdp_link::port::BATCH;
use gdp_util::unix_time::unix_nanos;

pub struct Scheduler {
    pub clock: Clock,
    stamps: Stamps,
    /// Turns to sign small messages.
    pub turns: Turns,
    links: Arc<Links>,
    queues: Mutex<Queues>,
    /// Wakes the sending thread.
    turn: Condvar,
    /// Whether any name is sent on two links.
    has_doubled: AtomicBool,
}

struct Queues {
    uplink: Uplink,
    /// Names that are sent on two links, together with the feedback about them.
    doubled: HashSet<Name>,
    /// The latest wake-up time while the sending thread sleeps.
    asleep: Option<u64>,
    /// Whether the sending thread must check for work at once.
    again: bool,
    stop: bool,
    events: Vec<Output>,
    /// Topics with batched small messages, and the time at which to seal them.
    batching: BTreeSet<(u64, TopicId)>,
}

/// The result of [`Scheduler::poll`].
pub struct Polled {
    pub now: u64,
    /// The time of the next output; `None` if it depends on other events.
    pub next: Option<u64>,
    /// Topics that have space for a waiting publisher.
    pub rooms: Vec<TopicId>,
}

/// Due work that the sending thread passes to the sealers.
pub struct Due {
    pub now: u64,
    /// Topics whose batches are due.
    pub batches: Vec<TopicId>,
    pub events: Vec<Output>,
}

impl Scheduler {
    pub fn new(links: Arc<Links>) -> Self {
        let (clock, max_payload) = (Clock::start(), usize::from(SMALLEST_PATH) - Header::LEN);
        let queues = Queues {
            uplink: Uplink::new(clock.now(), UplinkOptions { max_payload, budget: links.main_budget() }),
            doubled: HashSet::new(),
            asleep: None,
            again: false,
            stop: false,
            events: Vec::new(),
            batching: BTreeSet::new(),
        };
        let (turns, has_doubled) = (Turns::default(), AtomicBool::new(false));
        let stamps = Stamps::default();
        Self { clock, stamps, turns, links, queues: Mutex::new(queues), turn: Condvar::new(), has_doubled }
    }

    /// Returns the time to sign into messages, in Unix nanoseconds.
    pub fn stamp(&self) -> u64 {
        self.stamps.next(self.clock.now(), unix_nanos())
    }

    /// Returns the queues of all topics, locked. No other lock is taken under this lock.
    pub fn uplink(&self) -> MappedMutexGuard<'_, Uplink> {
        MutexGuard::map(self.queues.lock(), |queues| &mut queues.uplink)
    }

    /// Sets whether a name is sent on two links.
    pub fn double(&self, name: Name, doubled: bool) {
        let names = &mut self.queues.lock().doubled;
        if doubled {
            names.insert(name)
        } else {
            names.remove(&name)
        };
        self.has_doubled.store(!names.is_empty(), Ordering::Relaxed);
    }

    pub fn is_doubled(&self, name: &Name) -> bool {
        self.has_doubled() && self.queues.lock().doubled.contains(name)
    }

    pub fn has_doubled(&self) -> bool {
        self.has_doubled.load(Ordering::Relaxed)
    }

    /// Updates the rate limit to that of the current main link.
    pub fn update_budget(&self) {
        // Read under the lock, so that the last change of the link takes effect.
        let uplink = &mut self.queues.lock().uplink;
        uplink.set_budget(self.links.main_budget());
    }

    /// Returns the maximum payload of the frames of a topic's messages, in bytes.
    pub fn max_payload_of(&self, topic: TopicId) -> usize {
        let of_link = self.links.max_payload(self.has_doubled());
        let (now, mut uplink) = (self.clock.now(), self.uplink());
        of_link.into_iter().for_each(|of_link| fit(&mut uplink, now, of_link));
        uplink.max_payload_of(now, topic)
    }

    /// Adds frames that may be sent now to the batch. Outputs other than frames and space become
    /// events for the sending thread.
    pub fn poll(&self, max_payload: usize, batch: &mut Vec<Transmit>) -> Polled {
        let queues = &mut *self.queues.lock();
        let now = self.clock.now();
        let mut polled = Polled { now, next: Some(0), rooms: Vec::new() };
        fit(&mut queues.uplink, now, max_payload);
        while batch.len() < BATCH {
            match queues.uplink.poll(now) {
                Some(Output::Send(transmit)) => batch.push(transmit),
                Some(Output::Room { topic }) => polled.rooms.push(topic),
                Some(event) => queues.events.push(event),
                None => {
                    polled.next = queues.uplink.next_wake();
                    break;
                }
            }
        }
        if !queues.events.is_empty() {
            queues.plan(0, &self.turn);
        }
        polled
    }

    /// Schedules work for the sending thread at this time, if it would otherwise wake later.
    pub fn plan(&self, at: Option<u64>) {
        if let Some(at) = at {
            self.queues.lock().plan(at, &self.turn);
        }
    }

    /// Schedules the sealing of a topic's batch at this time.
    pub fn batch_until(&self, topic: TopicId, until: u64) {
        let mut queues = self.queues.lock();
        queues.batching.insert((until, topic));
        queues.plan(until, &self.turn);
    }

    /// Makes the sending thread check for work.
    pub fn wake(&self) {
        self.plan(Some(0));
    }

    /// Processes a reader's feedback, and schedules frames that it allows.
    pub fn feedback(&self, now: u64, topic: TopicId, reader: Name, feedback: &Feedback) {
        let mut queues = self.queues.lock();
        queues.uplink.feedback(now, topic, reader, feedback);
        if let Some(next) = queues.uplink.next_wake() {
            queues.plan(next, &self.turn);
        }
    }

    /// Stops the sending thread.
    pub fn stop(&self) {
        self.queues.lock().stop = true;
        self.turn.notify_one();
    }

    /// Waits for due work or until `next`, the time of the next frames. Returns the due work, or
    /// `None` if the sending thread must end.
    pub fn wait(&self, next: Option<u64>) -> Option<Due> {
        let mut queues = self.queues.lock();
        if queues.stop {
            return None;
        }
        let batched = queues.batching.first().map_or(u64::MAX, |(until, _)| *until);
        let until = next.unwrap_or(u64::MAX).min(batched);
        if queues.events.is_empty() && !queues.again && until > self.clock.now() {
            queues.asleep = Some(until);
            let time = Duration::from_nanos(until.saturating_sub(self.clock.now()));
            self.turn.wait_while_for(&mut queues, |queues| !queues.again && !queues.stop, time);
            queues.asleep = None;
        }
        queues.again = false;
        let (now, mut batches) = (self.clock.now(), Vec::new());
        while let Some((_, topic)) = queues.batching.first().copied().filter(|(until, _)| *until <= now) {
            queues.batching.pop_first();
            batches.push(topic);
        }
        Some(Due { now, batches, events: std::mem::take(&mut queues.events) })
    }
}

impl Queues {
    fn plan(&mut self, at: u64, turn: &Condvar) {
        match self.asleep {
            Some(until) if until <= at => {}
            Some(_) => {
                self.again = true;
                turn.notify_one();
            }
            None => self.again = true,
        }
    }
}

fn fit(uplink: &mut Uplink, now: u64, max_payload: usize) {
    if uplink.max_payload() != max_payload {
        uplink.set_max_payload(now, max_payload);
    }
}
