//! The daemon's clock, which the RIB, the topology and their timers count on.

use std::time::{Duration, Instant};

use gdp_rib::rib::Now;
use gdp_util::unix_time::unix_seconds;

/// Counts from the daemon's start.
#[derive(Clone, Copy, Debug)]
pub struct Clock(Instant);

impl Clock {
    pub fn start() -> Self {
        Self(Instant::now())
    }

    pub fn now(&self) -> Now {
        Now { unix: unix_seconds(), clock: self.0.elapsed() }
    }

    /// When [`Now::clock`] will be `clock`; none for a time so far off that no certificate should
    /// name it.
    pub fn instant(&self, clock: Duration) -> Option<Instant> {
        self.0.checked_add(clock)
    }
}
