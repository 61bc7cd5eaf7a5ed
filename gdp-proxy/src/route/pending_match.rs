//! Queues the first messages of a new writer until subscribers have matched it. Matching takes
//! milliseconds, or seconds on a busy machine. The publisher of a single message has left by then.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Time for which a best-effort writer waits for its first subscriber. Without one, nobody may want
/// the topic.
const TIMEOUT: Duration = Duration::from_millis(750);
/// The same for a reliable writer. It is longer, because no later message replaces a reliable one.
const RELIABLE_PATIENCE: Duration = Duration::from_secs(3);

/// Time after the first match for further subscribers to match, and for the first one to discover
/// the writer.
const SETTLE: Duration = Duration::from_millis(150);

/// Bound on the waiting messages of one writer.
const MAX_WAITING: usize = 256;
/// Bound on their bytes.
const MAX_WAITING_BYTES: usize = 16 << 20;

/// The messages of a new writer that wait for subscribers. `T` is a message.
pub struct PendingMatch<T> {
    until: Instant,
    has_matched: bool,
    /// The waiting messages with their sizes in bytes.
    waiting: VecDeque<(T, usize)>,
    /// Bytes of all waiting messages.
    bytes: usize,
}

impl<T> PendingMatch<T> {
    pub fn new(now: Instant, is_reliable: bool) -> Self {
        let patience = if is_reliable { RELIABLE_PATIENCE } else { TIMEOUT };
        Self { until: now + patience, has_matched: false, waiting: VecDeque::new(), bytes: 0 }
    }

    pub fn push(&mut self, message: T, bytes: usize) {
        self.waiting.push_back((message, bytes));
        self.bytes += bytes;
    }

    /// Returns the bytes of all waiting messages.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Drops the oldest message and returns its size in bytes.
    pub fn drop_oldest(&mut self) -> usize {
        let bytes = self.waiting.pop_front().map_or(0, |(_, bytes)| bytes);
        self.bytes -= bytes;
        bytes
    }

    /// Whether the messages need not wait any longer. `is_matched` returns whether the writer has a
    /// subscriber.
    pub fn is_over(&mut self, now: Instant, is_matched: impl FnOnce() -> bool) -> bool {
        if !self.has_matched && is_matched() {
            self.has_matched = true;
            self.until = self.until.min(now + SETTLE);
        }
        now >= self.until || self.waiting.len() > MAX_WAITING || self.bytes > MAX_WAITING_BYTES
    }

    pub fn into_waiting(self) -> impl Iterator<Item = T> {
        self.waiting.into_iter().map(|(message, _)| message)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/route/pending_match.rs"]
mod tests;
