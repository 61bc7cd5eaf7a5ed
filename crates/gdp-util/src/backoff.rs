//! Delays between attempts. Each delay is twice the previous one, up to a maximum.

use std::time::Duration;

/// The delays of one sequence of attempts. It uses no clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backoff {
    first: Duration,
    longest: Duration,
    next: Duration,
}

impl Backoff {
    /// Creates a backoff with the delay after the first failure and the maximum delay.
    pub const fn new(first: Duration, longest: Duration) -> Self {
        Self { first, longest, next: first }
    }

    /// Returns the delay before the next attempt.
    pub fn delay(&self) -> Duration {
        self.next
    }

    /// Returns the delay before the next attempt, and doubles the following one.
    pub fn next_delay(&mut self) -> Duration {
        let delay = self.next;
        self.next = (delay * 2).min(self.longest);
        delay
    }

    /// Resets the next delay to the first one, after an attempt has succeeded.
    pub fn reset(&mut self) {
        self.next = self.first;
    }

    /// Returns the delay after this number of consecutive failures, for callers that count them.
    pub fn after(self, failures: u32) -> Duration {
        self.first.saturating_mul(1 << failures.saturating_sub(1).min(31)).min(self.longest)
    }
}

/// Returns a delay between half of `delay` and all of it, so that many peers do not retry at the
/// same time. `random` is any byte.
pub fn jittered(delay: Duration, random: u8) -> Duration {
    delay / 2 + delay / 512 * u32::from(random)
}

#[cfg(test)]
#[path = "../tests/unit/backoff.rs"]
mod tests;
