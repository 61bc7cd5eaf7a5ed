//! What a loop does while nothing arrives. A loop that asks its devices without end takes a whole
//! core, which on a robot is somebody else's; one that sleeps between questions takes next to
//! nothing, and lets the first packet after a pause wait for as long as it sleeps.

use std::time::Duration;

/// Questions in vain before a loop sleeps: some tens of microseconds, in which the next packet of a
/// stream comes.
const TIMEOUT: u32 = 512;

/// The first sleep; each is twice as long as the one before.
const SHORTEST: Duration = Duration::from_micros(10);

/// What a loop does while nothing arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Idle {
    /// It asks on.
    Busy,
    /// It sleeps, ever longer, up to so long.
    Sleep(Duration),
}

impl Default for Idle {
    /// A quarter of a millisecond.
    fn default() -> Self {
        Self::Sleep(Duration::from_micros(250))
    }
}

/// Decides how long a loop sleeps.
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

    /// How long to sleep now, after a question that was answered, or in vain.
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

/// Has the kernel end this thread's sleeps when they are over, and not up to 50 µs later.
pub fn sleep_exactly() {
    // SAFETY: sets a number of this thread.
    unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1) };
}

#[cfg(test)]
#[path = "../tests/unit/idle.rs"]
mod tests;
