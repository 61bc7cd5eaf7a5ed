//! Delays between attempts: each twice as long as the one before, up to a maximum.

use std::time::Duration;

/// The delays of one sequence of attempts. Knows no clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backoff {
    first: Duration,
    longest: Duration,
    next: Duration,
}

impl Backoff {
    /// `first`: the delay after the first failure; `longest`: the delay that is never exceeded.
    pub const fn new(first: Duration, longest: Duration) -> Self {
        Self { first, longest, next: first }
    }

    /// The delay before the next attempt.
    pub fn next_delay(&mut self) -> Duration {
        let delay = self.next;
        self.next = (delay * 2).min(self.longest);
        delay
    }

    /// The next delay is the first one again: an attempt has succeeded.
    pub fn reset(&mut self) {
        self.next = self.first;
    }

    /// The delay after this many failures in a row, for callers that count them.
    pub fn after(self, failures: u32) -> Duration {
        self.first.saturating_mul(1 << failures.saturating_sub(1).min(31)).min(self.longest)
    }
}

/// A delay between half of `delay` and the whole, so that many do not try at the same time.
/// `random`: any byte.
pub fn jittered(delay: Duration, random: u8) -> Duration {
    delay / 2 + delay / 512 * u32::from(random)
}

#[cfg(test)]
#[path = "../tests/unit/backoff.rs"]
mod tests;
