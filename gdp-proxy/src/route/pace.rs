//! Limits the rate of each publisher's messages. The newest message above the rate waits for its
//! turn, so that the last one is not lost.

use std::collections::HashMap;
use std::num::NonZeroU32;
use std::time::{Duration, Instant};

use crate::graph::Key;

/// `T`: a message.
pub struct Pace<T> {
    period: Option<Duration>,
    publishers: HashMap<Option<Key>, PublisherTurn<T>>,
}

struct PublisherTurn<T> {
    /// When the next message is wanted.
    due: Instant,
    /// The newest since the last that went.
    pending: Option<T>,
}

impl<T> Pace<T> {
    pub fn new(max_hz: Option<NonZeroU32>) -> Self {
        Self { period: max_hz.map(|hz| Duration::from_secs(1) / hz.get()), publishers: HashMap::new() }
    }

    /// A message comes: what goes now, if anything does, and how many messages it takes the place
    /// of.
    pub fn take(&mut self, now: Instant, from: Option<Key>, message: T) -> (Option<T>, u64) {
        let Some(period) = self.period else { return (Some(message), 0) };
        let turn = self.publishers.entry(from).or_insert(PublisherTurn { due: now, pending: None });
        let replaced = u64::from(turn.pending.take().is_some());
        if now < turn.due {
            turn.pending = Some(message);
            return (None, replaced);
        }
        // A message that comes a little late does not shift all that follow.
        turn.due = if now - turn.due < period { turn.due + period } else { now + period };
        (Some(message), replaced)
    }

    /// When something that is held is to go: half a period after its turn, for one that comes by
    /// itself soon after is newer.
    pub fn next(&self) -> Option<Instant> {
        let grace = self.period? / 2;
        self.publishers.values().filter(|turn| turn.pending.is_some()).map(|turn| turn.due + grace).min()
    }

    /// What is held and is to go now; one for each call.
    pub fn overdue(&mut self, now: Instant) -> Option<T> {
        let period = self.period?;
        let waits = |turn: &&mut PublisherTurn<T>| turn.pending.is_some() && now >= turn.due + period / 2;
        let turn = self.publishers.values_mut().find(waits)?;
        turn.due = now + period;
        turn.pending.take()
    }

    /// What is held of a publisher that has gone.
    pub fn left(&mut self, key: Key) -> Option<T> {
        self.publishers.remove(&Some(key))?.pending
    }
}

#[cfg(test)]
#[path = "../../tests/unit/route/pace.rs"]
mod tests;
