//! Queues the first messages of a new writer until subscribers have matched it. Matching takes
//! milliseconds, or seconds on a busy machine. The publisher of a single message has left by then.
//!
//! The queue is then released in portions, within 100 ms. A few messages at once would already be
//! more than a subscriber's history holds, which keeps the newest only. How deep that history is,
//! discovery does not say.

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

/// Number of portions in which the waiting messages are released, with as many calls of
/// [`PendingMatch::take`].
const PORTIONS: usize = 5;

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
    portions: usize,
}

impl<T> PendingMatch<T> {
    pub fn new(now: Instant, is_reliable: bool) -> Self {
        let patience = if is_reliable { RELIABLE_PATIENCE } else { TIMEOUT };
        Self { until: now + patience, has_matched: false, waiting: VecDeque::new(), bytes: 0, portions: PORTIONS }
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

    /// Removes the messages that are to be written now. `is_matched` returns whether the writer has
    /// a subscriber.
    pub fn take(&mut self, now: Instant, is_matched: impl FnOnce() -> bool) -> Vec<T> {
        if self.portions == PORTIONS && !self.is_over(now, is_matched) {
            return Vec::new();
        }
        let count = self.waiting.len().div_ceil(self.portions.max(1));
        self.portions = self.portions.saturating_sub(1);
        let taken: Vec<_> = self.waiting.drain(..count).collect();
        self.bytes -= taken.iter().map(|(_, bytes)| bytes).sum::<usize>();
        taken.into_iter().map(|(message, _)| message).collect()
    }

    /// Whether later messages need not wait.
    pub fn is_done(&self) -> bool {
        self.portions < PORTIONS && self.waiting.is_empty()
    }

    fn is_over(&mut self, now: Instant, is_matched: impl FnOnce() -> bool) -> bool {
        if !self.has_matched && is_matched() {
            self.has_matched = true;
            self.until = self.until.min(now + SETTLE);
        }
        now >= self.until || self.waiting.len() > MAX_WAITING || self.bytes > MAX_WAITING_BYTES
    }

    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/route/pending_match.rs"]
mod tests;
