//! A bounded queue between a writer that must not wait and one reader that may be slow. A full
//! queue drops its oldest item and counts it.

use std::collections::VecDeque;

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::Notify;

/// The limits of a queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueueLimits {
    /// Maximum number of messages; 0 means 1.
    pub messages: usize,
    /// Maximum size of all messages, in bytes. A single larger message still fits alone.
    pub bytes: usize,
}

impl Default for QueueLimits {
    /// Returns 100 messages and 128 MiB.
    fn default() -> Self {
        Self { messages: 100, bytes: 128 << 20 }
    }
}

pub struct Queue<T> {
    limits: QueueLimits,
    waiting: Mutex<QueuedItem<T>>,
    pushed: Notify,
}

struct QueuedItem<T> {
    /// The items, each with its size in bytes.
    items: VecDeque<(T, usize)>,
    bytes: usize,
    dropped: u64,
}

impl<T> Queue<T> {
    pub fn new(limits: QueueLimits) -> Self {
        let waiting = QueuedItem { items: VecDeque::new(), bytes: 0, dropped: 0 };
        Self { limits, waiting: Mutex::new(waiting), pushed: Notify::new() }
    }

    /// Adds an item of `bytes` bytes, and drops the oldest items that exceed the limits.
    pub fn push(&self, item: T, bytes: usize) {
        let mut waiting = self.waiting();
        waiting.items.push_back((item, bytes));
        waiting.bytes = waiting.bytes.saturating_add(bytes);
        while waiting.items.len() > 1
            && (waiting.items.len() > self.limits.messages || waiting.bytes > self.limits.bytes)
        {
            let gone = waiting.items.pop_front();
            waiting.bytes -= gone.map_or(0, |(_, bytes)| bytes);
            waiting.dropped += 1;
        }
        drop(waiting);
        self.pushed.notify_one();
    }

    /// Waits for the oldest item and removes it. Only one reader may wait.
    pub async fn pop(&self) -> T {
        loop {
            if let Some(item) = self.try_pop() {
                return item;
            }
            self.pushed.notified().await;
        }
    }

    pub fn try_pop(&self) -> Option<T> {
        let mut waiting = self.waiting();
        let (item, bytes) = waiting.items.pop_front()?;
        waiting.bytes -= bytes;
        Some(item)
    }

    /// Returns the number of dropped items.
    pub fn dropped(&self) -> u64 {
        self.waiting().dropped
    }

    fn waiting(&self) -> MutexGuard<'_, QueuedItem<T>> {
        self.waiting.lock()
    }
}

#[cfg(test)]
#[path = "../tests/unit/queue.rs"]
mod tests;
