//! The clock that all parts of a node share.

use std::time::Instant;

use gdp_e2e::seal::Timestamps;
use gdp_util::unix_time::unix_nanos;

/// A steady clock that starts at zero.
#[derive(Clone, Copy, Debug)]
pub struct Clock(Instant);

impl Clock {
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Returns the nanoseconds since the start. Never decreases.
    pub fn now(&self) -> u64 {
        self.0.elapsed().as_nanos() as u64
    }

    pub fn timestamps(&self) -> Timestamps {
        Timestamps { steady_ns: self.now(), unix_ns: unix_nanos() }
    }
}
