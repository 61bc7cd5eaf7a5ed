//! The middle stage of the send path: the queues of all topics, scheduled for the main link, and
//! what the sending thread does next. It knows the links below it, and nobody above.

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use gdp_wire::{Header, Name, SMALLEST_PATH};
use parking_lot::{Condvar, MappedMutexGuard, Mutex, MutexGuard};

use super::clock::Clock;
use super::links::Links;
use super::message_batch::Turns;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::transport::{Output, TopicId, Transmit, Uplink, UplinkOptions};
use gdp_link::port::BATCH;

pub struct Scheduler {
    pub clock: Clock,
    /// To sign.
    pub turns: Turns,
    links: Arc<Links>,
    queues: Mutex<Queues>,
    /// Wakes the sending thread.
    turn: Condvar,
    /// Whether anything goes by two links.
    has_doubled: AtomicBool,
}

struct Queues {
    uplink: Uplink,
    /// Names that go by two links, and what is said about them as well.
    doubled: HashSet<Name>,
    /// The sending thread sleeps, until then at the latest.
    asleep: Option<u64>,
    /// The sending thread is to look at once.
    again: bool,
    stop: bool,
    events: Vec<Output>,
    /// Topics whose small messages wait for others, and until when.
    batching: BTreeSet<(u64, TopicId)>,
}

/// What came of [`Scheduler::poll`].
pub struct Polled {
    pub now: u64,
    /// When there is more; `None` if it depends on others.
    pub next: Option<u64>,
    /// Topics that have room for a publisher that waits.
    pub rooms: Vec<TopicId>,
}

/// What the sending thread brings to the sealers.
pub struct Due {
    pub now: u64,
    /// Topics whose small messages wait no longer.
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
        Self { clock, turns, links, queues: Mutex::new(queues), turn: Condvar::new(), has_doubled }
    }

    /// The queues of all topics, locked. Nothing else is locked under it.
    pub fn uplink(&self) -> MappedMutexGuard<'_, Uplink> {
        MutexGuard::map(self.queues.lock(), |queues| &mut queues.uplink)
    }

    /// Whether this goes by two links from now on.
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

    /// Schedules for the link that is the main one now.
    pub fn update_budget(&self) {
        // Under the lock, so that the last to change the link has the last word.
        let uplink = &mut self.queues.lock().uplink;
        uplink.set_budget(self.links.main_budget());
    }

    /// Bytes that the frames of a topic's messages may carry.
    pub fn max_payload_of(&self, topic: TopicId) -> usize {
        let of_link = self.links.max_payload(self.has_doubled());
        let (now, mut uplink) = (self.clock.now(), self.uplink());
        of_link.into_iter().for_each(|of_link| fit(&mut uplink, now, of_link));
        uplink.max_payload_of(now, topic)
    }

    /// Puts frames that may go now into the batch. What is neither a frame nor room is an event for
    /// the sending thread.
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

    /// The sending thread has something to do at this time, if it does not know.
    pub fn plan(&self, at: Option<u64>) {
        if let Some(at) = at {
            self.queues.lock().plan(at, &self.turn);
        }
    }

    /// What a topic batches is sealed at this time.
    pub fn batch_until(&self, topic: TopicId, until: u64) {
        let mut queues = self.queues.lock();
        queues.batching.insert((until, topic));
        queues.plan(until, &self.turn);
    }

    /// Something changed that the sending thread is to look at.
    pub fn wake(&self) {
        self.plan(Some(0));
    }

    /// Takes what a reader reports. What that makes room for goes.
    pub fn feedback(&self, now: u64, topic: TopicId, reader: Name, feedback: &Feedback) {
        let mut queues = self.queues.lock();
        queues.uplink.feedback(now, topic, reader, feedback);
        if let Some(next) = queues.uplink.next_wake() {
            queues.plan(next, &self.turn);
        }
    }

    /// Ends the sending thread.
    pub fn stop(&self) {
        self.queues.lock().stop = true;
        self.turn.notify_one();
    }

    /// What is due, once anything is, or there is something to send, as there is at `next`. `None`:
    /// the sending thread is to end.
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
