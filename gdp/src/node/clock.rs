//! The one clock of a node.

use std::time::{Duration, Instant, SystemTime};

use crate::seal::Moment;

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

    pub fn moment(&self) -> Moment {
        Moment { steady_ns: self.now(), unix_ns: unix_nanos() }
    }
}

/// Nanoseconds since the Unix epoch.
pub fn unix_nanos() -> u64 {
    unix().as_nanos() as u64
}

/// Seconds since the Unix epoch.
pub fn unix_now() -> u64 {
    unix().as_secs()
}

fn unix() -> Duration {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}
