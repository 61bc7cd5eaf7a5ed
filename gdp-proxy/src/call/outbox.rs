//! Queues events of remote goals until the proxy publishes them here: in order, and bounded.

use std::collections::VecDeque;

use bytes::Bytes;
use gdp_ros::call::Event;

/// Feedback that waits, and bytes of it; beyond, the oldest goes.
const MAX_WAITING: usize = 256;
const MAX_WAITING_BYTES: usize = 4 << 20;

/// Of one action.
#[derive(Default)]
pub struct Outbox {
    waiting: VecDeque<Event>,
    /// Of feedback.
    count: usize,
    bytes: usize,
}

impl Outbox {
    /// Returns how many are dropped for it.
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

    /// Of all goals: it replaces the one that waits.
    pub fn status(&mut self, message: Bytes) {
        self.waiting.retain(|event| matches!(event, Event::Feedback(_)));
        self.waiting.push_back(Event::Status(message));
    }

    /// What is to be published next.
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
