//! Limits the rate of each publisher's messages. The newest message above the rate waits for its
//! turn, so that the last one is not lost.

use std::collections::HashMap;
use std::num::NonZeroU32;
use std::time::{Duration, Instant};

use crate::graph::Key;

/// The rate limit of all publishers of a topic. `T` is a message.
pub struct Pace<T> {
    period: Option<Duration>,
    publishers: HashMap<Option<Key>, PublisherTurn<T>>,
}

struct PublisherTurn<T> {
    /// The time from which the next message may be sent.
    due: Instant,
    /// The newest message since the last one sent.
    pending: Option<T>,
}

impl<T> Pace<T> {
    pub fn new(max_hz: Option<NonZeroU32>) -> Self {
        Self { period: max_hz.map(|hz| Duration::from_secs(1) / hz.get()), publishers: HashMap::new() }
    }

    /// Accepts a message. Returns the message if it is to be sent now, and the number of waiting
    /// messages that it replaces.
    pub fn take(&mut self, now: Instant, from: Option<Key>, message: T) -> (Option<T>, u64) {
        let Some(period) = self.period else { return (Some(message), 0) };
        let turn = self.publishers.entry(from).or_insert(PublisherTurn { due: now, pending: None });
        let replaced = u64::from(turn.pending.take().is_some());
        if now < turn.due {
            turn.pending = Some(message);
            return (None, replaced);
        }
        // A slightly late message does not delay all later ones.
        turn.due = if now - turn.due < period { turn.due + period } else { now + period };
        (Some(message), replaced)
    }

    /// Returns the time at which a waiting message must be sent. That is half a period after its
    /// turn, because a newer message may arrive until then.
    pub fn next(&self) -> Option<Instant> {
        let grace = self.period? / 2;
        self.publishers.values().filter(|turn| turn.pending.is_some()).map(|turn| turn.due + grace).min()
    }

    /// Returns one waiting message that is overdue.
    pub fn overdue(&mut self, now: Instant) -> Option<T> {
        let period = self.period?;
        let waits = |turn: &&mut PublisherTurn<T>| turn.pending.is_some() && now >= turn.due + period / 2;
        let turn = self.publishers.values_mut().find(waits)?;
        turn.due = now + period;
        turn.pending.take()
    }

    /// Removes a publisher that has left, and returns its waiting message.
    pub fn left(&mut self, key: Key) -> Option<T> {
        self.publishers.remove(&Some(key))?.pending
    }
}

#[cfg(test)]
#[path = "../../tests/unit/route/pace.rs"]
mod tests;
