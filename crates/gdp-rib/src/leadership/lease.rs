//! The leader's own timer for its lease at etcd.
//!
//! Two replicas must not lead at once. So the leader's timer starts before it requests the lease,
//! and is shorter than etcd's.

use std::ops::Add;
use std::time::Duration;

/// The lifetime of a leader's lease at etcd.
pub const TTL: Duration = Duration::from_secs(5);

/// How much earlier the leader's own timer ends than the lease. It covers clock drift and the
/// leader's last messages in flight.
pub const MARGIN: Duration = Duration::from_secs(1);

/// Returns the time at which the leader's timer ends, for a lease that it requested or renewed at
/// this time.
pub fn end_of_lease<T: Add<Duration, Output = T>>(requested: T) -> T {
    requested + (TTL - MARGIN)
}

/// The timer of one term. `T` is a time on the leader's monotonic clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Lease<T>(T);

impl<T: Copy + Ord> Lease<T> {
    pub fn new(ends: T) -> Self {
        Self(ends)
    }

    pub fn ends(&self) -> T {
        self.0
    }

    pub fn is_over(&self, now: T) -> bool {
        now >= self.0
    }

    /// Extends the term and returns true. Returns false if the term is already over, because other
    /// tasks may have acted on its end.
    pub fn extend(&mut self, now: T, to: T) -> bool {
        let lasts = !self.is_over(now);
        if lasts {
            self.0 = to;
        }
        lasts
    }

    /// Ends the term now.
    pub fn end(&mut self, now: T) {
        self.0 = now;
    }
}
