//! Queues the events of goals for each client that sent one, until the client has received them.

use std::collections::{HashMap, VecDeque};
use std::time::Instant;

use bytes::Bytes;
use gdp_wire::Name;

use super::LINGER;
use crate::call::{Event, Events, MAX_EVENTS};

/// Maximum number of clients with a queue.
const MAX_CALLERS: usize = 256;

/// Maximum number of feedback messages in one queue. `MAX_WAITING_BYTES` bounds their size. Beyond
/// either bound the oldest are dropped.
const MAX_WAITING: usize = 256;
const MAX_WAITING_BYTES: usize = 4 << 20;

/// Maximum size of a reply with several events, in bytes. A single event may exceed it.
const MAX_REPLY: usize = 1 << 20;

/// The event queues of one action whose server is local.
#[derive(Default)]
pub struct Log {
    callers: HashMap<Name, Caller>,
}

struct Caller {
    /// The number of the next event. The first has number 1.
    next: u64,
    feedback: VecDeque<(u64, Bytes)>,
    bytes: usize,
    dropped: u64,
    /// The newest status with its number. A new status replaces the previous one.
    status: Option<(u64, Bytes)>,
    last_seen: Instant,
}

/// The error when [`Log`] already has queues for the maximum number of clients.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{MAX_CALLERS} callers are told of their goals already; call again later")]
pub struct LogError;

impl Log {
    /// Creates the queue of a client, or notes that the client is still active.
    pub fn add_caller(&mut self, now: Instant, caller: Name) -> Result<(), LogError> {
        if let Some(known) = self.callers.get_mut(&caller) {
            known.last_seen = now;
            return Ok(());
        }
        if self.callers.len() >= MAX_CALLERS {
            return Err(LogError);
        }
        let (feedback, status) = (VecDeque::new(), None);
        let new = Caller { next: 1, feedback, bytes: 0, dropped: 0, status, last_seen: now };
        self.callers.insert(caller, new);
        Ok(())
    }

    /// Queues a feedback message. Returns the number of feedback messages that were dropped.
    pub fn feedback(&mut self, caller: &Name, message: Bytes) -> u64 {
        let Some(caller) = self.callers.get_mut(caller) else { return 1 };
        caller.bytes += message.len();
        caller.feedback.push_back((caller.next, message));
        caller.next += 1;
        let before = caller.dropped;
        while caller.feedback.len() > MAX_WAITING || (caller.bytes > MAX_WAITING_BYTES && caller.feedback.len() > 1) {
            caller.drop_first();
            caller.dropped += 1;
        }
        caller.dropped - before
    }

    /// Queues the status of the client's goals if it differs from the previous one.
    pub fn status(&mut self, caller: &Name, message: Bytes) {
        let Some(caller) = self.callers.get_mut(caller) else { return };
        if caller.status.as_ref().is_none_or(|(_, before)| *before != message) {
            caller.status = Some((caller.next, message));
            caller.next += 1;
        }
    }

    /// Returns the events after number `after`, or `None` if there are none. Removes the feedback
    /// up to `after`, which the client has received.
    pub fn after(&mut self, caller: &Name, after: u64) -> Option<Events> {
        let caller = self.callers.get_mut(caller)?;
        while caller.feedback.front().is_some_and(|(number, _)| *number <= after) {
            caller.drop_first();
        }
        let status = caller.status.iter().filter(|(number, _)| *number > after);
        let mut waiting: Vec<(u64, Event)> =
            status.map(|(number, message)| (*number, Event::Status(message.clone()))).collect();
        waiting.extend(caller.feedback.iter().map(|(number, message)| (*number, Event::Feedback(message.clone()))));
        waiting.sort_by_key(|(number, _)| *number);
        let mut events = Events { last: after, dropped: 0, events: Vec::new() };
        let mut size = 0;
        for (number, event) in waiting.into_iter().take(MAX_EVENTS) {
            let (Event::Feedback(message) | Event::Status(message)) = &event;
            size += message.len();
            if size > MAX_REPLY && !events.events.is_empty() {
                break;
            }
            events.last = number;
            events.events.push(event);
        }
        if events.events.is_empty() {
            return None;
        }
        events.dropped = std::mem::take(&mut caller.dropped);
        Some(events)
    }

    /// Removes the queues of clients that were inactive for [`LINGER`], except those for which
    /// `stays` returns true.
    pub fn sweep(&mut self, now: Instant, stays: impl Fn(&Name) -> bool) {
        self.callers.retain(|caller, known| now.saturating_duration_since(known.last_seen) < LINGER || stays(caller));
    }

    pub fn callers(&self) -> impl Iterator<Item = &Name> {
        self.callers.keys()
    }
}

impl Caller {
    fn drop_first(&mut self) {
        self.bytes -= self.feedback.pop_front().map_or(0, |(_, message)| message.len());
    }
}

#[cfg(test)]
#[path = "../../tests/unit/action/log.rs"]
mod tests;
