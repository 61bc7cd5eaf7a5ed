//! What a loop does while nothing arrives. A loop that asks its devices without end takes a whole core, which on a robot is somebody
//! else's; one that sleeps between questions takes next to nothing, and lets the first packet after a pause wait for as long as it sleeps.

use std::time::Duration;

/// Questions in vain before a loop sleeps: some tens of microseconds, in which the next packet of a stream comes.
const PATIENCE: u32 = 512;

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
        if self.vain <= PATIENCE {
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
mod tests {
    use super::*;

    #[test]
    fn it_asks_for_a_while_then_sleeps_ever_longer_until_something_comes() {
        let mut rest = Rest::new(Idle::Sleep(Duration::from_micros(70)));
        for _ in 0..2 {
            assert!((0..PATIENCE).all(|_| rest.after(false).is_none()));
            let sleeps: Vec<_> = (0..6).filter_map(|_| rest.after(false)).map(|sleep| sleep.as_micros()).collect();
            assert_eq!(sleeps, [10, 20, 40, 70, 70, 70]);
            assert_eq!(rest.after(true), None);
        }
        let mut busy = Rest::new(Idle::Busy);
        assert!((0..10 * PATIENCE).all(|_| busy.after(false).is_none()));
    }
}
