//! How long a reader waits for segments that are out of order before it requests them.

use std::collections::VecDeque;

use super::{MS, Position};

/// Minimum tolerance for reordered segments. The tolerance is an eighth of the round-trip time, if
/// that is longer. A gap is requested at an age of one to two tolerances.
pub const LEAST_TOLERANCE: u64 = 2 * MS;

/// Maximum tolerance after needless requests, unless the round trip is longer.
const MOST_TOLERANCE: u64 = 64 * MS;

/// Time after a needless request in which the tolerance stays. It is halved after that.
const NEEDLESS_FOR: u64 = 5_000 * MS;

/// Number of requested segments whose duplicates are recognised.
const MOST_ANSWERED: usize = 256;

/// The tolerance for reordered segments. A needless request doubles it, as in RACK (RFC 8985). The
/// usual cause is a writer or a switch that waits for a processor.
#[derive(Debug, Default)]
pub struct ReorderingWindow {
    /// Tolerance after needless requests; 0: there was none lately.
    extra: u64,
    needless_at: u64,
    /// The last requested segments that arrived. If one arrives again, its request was needless.
    answered: VecDeque<Position>,
}

impl ReorderingWindow {
    /// Returns the tolerance on a path with this round-trip time.
    pub fn tolerance(&self, rtt: u64) -> u64 {
        (rtt / 8).max(LEAST_TOLERANCE).max(self.extra)
    }

    /// Returns the tolerance that needless requests have caused.
    pub fn extra(&self) -> u64 {
        self.extra
    }

    /// Records that a requested segment has arrived.
    pub fn on_answer(&mut self, position: Position) {
        if self.answered.len() == MOST_ANSWERED {
            self.answered.pop_front();
        }
        self.answered.push_back(position);
    }

    /// Records that a segment has arrived again. Returns whether its request was needless.
    pub fn on_duplicate(&mut self, now: u64, position: Position, rtt: u64) -> bool {
        let before = self.tolerance(rtt);
        let Some(index) = self.answered.iter().position(|answered| *answered == position) else { return false };
        // Each request counts once.
        self.answered.remove(index);
        // All requests of one tolerance have one cause.
        if now >= self.needless_at + before {
            self.extra = (2 * before).min(MOST_TOLERANCE.max(rtt));
            self.needless_at = now;
        }
        true
    }

    /// Reduces the tolerance after some time without needless requests.
    pub fn look(&mut self, now: u64) {
        if self.extra > 0 && now >= self.needless_at + NEEDLESS_FOR {
            self.extra = if self.extra > LEAST_TOLERANCE { self.extra / 2 } else { 0 };
            self.needless_at = now;
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/transport/reordering.rs"]
mod tests;
