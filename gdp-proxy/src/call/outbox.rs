//! Queues events of remote goals until the proxy publishes them here: in order, and bounded.

use std::collections::VecDeque;

use bytes::Bytes;
use gdp_ros::call::Event;

/// Bound on the waiting feedback messages. Beyond it the oldest message is dropped.
const MAX_WAITING: usize = 256;
/// Bound on their bytes. Beyond it the oldest message is dropped.
const MAX_WAITING_BYTES: usize = 4 << 20;

/// The outgoing events of one action.
#[derive(Default)]
pub struct Outbox {
    waiting: VecDeque<Event>,
    /// Number of waiting feedback messages.
    count: usize,
    /// Bytes of waiting feedback messages.
    bytes: usize,
}

impl Outbox {
    /// Queues feedback. Returns the number of older messages that it displaced.
    pub fn feedback(&mut self, message: Bytes) -> u64 {
        self.count += 1;
        self.bytes += message.len();
        self.waiting.push_back(Event::Feedback(message));
        let mut dropped = 0;
        while self.count > MAX_WAITING || (self.bytes > MAX_WAITING_BYTES && self.count > 1) {
            let oldest = self.waiting.iter().position(|event| matches!(event, Event::Feedback(_)));
            let Some(gone) = oldest.and_then(|at| self.waiting.remove(at)) else { break };
            self.forget(&gone);
            dropped += 1;
        }
        dropped
    }

    /// Queues the status of all goals. It replaces a waiting status.
    pub fn status(&mut self, message: Bytes) {
        self.waiting.retain(|event| matches!(event, Event::Feedback(_)));
        self.waiting.push_back(Event::Status(message));
    }

    /// Returns the next event to publish.
    pub fn next(&mut self) -> Option<Event> {
        let next = self.waiting.pop_front()?;
        self.forget(&next);
        Some(next)
    }

    fn forget(&mut self, event: &Event) {
        if let Event::Feedback(message) = event {
            self.count -= 1;
            self.bytes -= message.len();
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/call/outbox.rs"]
mod tests;
