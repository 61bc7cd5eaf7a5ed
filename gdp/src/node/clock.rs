//! The one clock of a node.

use std::time::Instant;

use gdp_e2e::seal::Timestamps;
use gdp_util::unix_time::unix_nanos;

/// Counts from its making on.
#[derive(Clone, Copy, Debug)]
pub struct Clock(Instant);

impl Clock {
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Nanoseconds; never goes back.
    pub fn now(&self) -> u64 {
        self.0.elapsed().as_nanos() as u64
    }

    pub fn timestamps(&self) -> Timestamps {
        Timestamps { steady_ns: self.now(), unix_ns: unix_nanos() }
    }
}
