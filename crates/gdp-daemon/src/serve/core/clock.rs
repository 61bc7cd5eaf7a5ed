//! The daemon's clock. The RIB, the topology and their timers use it.

use std::time::{Duration, Instant};

use gdp_rib::rib::Now;
use gdp_util::unix_time::unix_seconds;

/// A monotonic clock that starts at zero when the daemon starts.
#[derive(Clone, Copy, Debug)]
pub struct Clock(Instant);

impl Clock {
    pub fn start() -> Self {
        Self(Instant::now())
    }

    pub fn now(&self) -> Now {
        Now { unix: unix_seconds(), clock: self.0.elapsed() }
    }

    /// Returns the instant at which [`Now::clock`] equals `clock`. Returns `None` on overflow; no
    /// certificate should name a time that far off.
    pub fn instant(&self, clock: Duration) -> Option<Instant> {
        self.0.checked_add(clock)
    }
}
