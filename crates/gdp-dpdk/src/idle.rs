//! Idle behaviour of a loop. A loop that polls continuously uses a whole core, which a robot needs
//! for other work. A loop that sleeps between polls uses almost no processor time. The first packet
//! after a pause then waits until the end of the sleep.

use std::time::Duration;

/// Number of empty polls before a loop sleeps. They take some tens of microseconds, enough for the
/// next packet of a stream to arrive.
const TIMEOUT: u32 = 512;

/// The first sleep. Each sleep is twice as long as the preceding one.
const SHORTEST: Duration = Duration::from_micros(10);

/// Idle behaviour of a loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Idle {
    /// Polls continuously.
    Busy,
    /// Sleeps with increasing duration, up to this maximum.
    Sleep(Duration),
}

impl Default for Idle {
    /// Sleeps at most a quarter of a millisecond.
    fn default() -> Self {
        Self::Sleep(Duration::from_micros(250))
    }
}

/// Determines how long a loop sleeps.
#[derive(Clone, Copy, Debug)]
pub struct Rest {
    idle: Idle,
    vain: u32,
    next: Duration,
}

impl Rest {
    pub fn new(idle: Idle) -> Self {
        Self { idle, vain: 0, next: SHORTEST }
    }

    /// Returns how long to sleep after a poll. `answered`: whether the poll returned packets.
    pub fn after(&mut self, answered: bool) -> Option<Duration> {
        let Idle::Sleep(longest) = self.idle else { return None };
        if answered {
            (self.vain, self.next) = (0, SHORTEST);
            return None;
        }
        self.vain = self.vain.saturating_add(1);
        if self.vain <= TIMEOUT {
            return None;
        }
        let now = self.next.min(longest);
        self.next = (now * 2).min(longest);
        Some(now)
    }
}

/// Sets the timer slack of this thread to 1 ns, so that sleeps do not end up to 50 µs late.
pub fn sleep_exactly() {
    // SAFETY: the call sets a number of this thread.
    unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1) };
}

#[cfg(test)]
#[path = "../tests/unit/idle.rs"]
mod tests;
