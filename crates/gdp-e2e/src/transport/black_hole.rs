//! Detection of paths that silently drop large frames, such as a tunnel with a smaller MTU than its
//! ends assume. On such a path, repairs of large frames never arrive, but small frames do. The
//! topic then sends small frames for a while, and tries large ones again later (after RFC 8899,
//! §4.3).

use gdp_wire::Header;

use super::{MS, Position};
use crate::feedback_wire::Missing;
use gdp_wire::SMALLEST_PATH;

/// The payload of a frame that every path supports, in bytes.
pub const LEAST_PAYLOAD: usize = SMALLEST_PATH as usize - Header::LEN;

/// Number of requests for the same segment that indicate such a path, if no large frame arrives in
/// between.
const ASKED: u32 = 5;

/// Duration of the first period with small frames only. The duration doubles each time, up to
/// [`LONGEST_SMALL_TIME`].
const SMALL_TIME: u64 = 30_000 * MS;
const LONGEST_SMALL_TIME: u64 = 600_000 * MS;

/// A segment without a new request for this time has arrived or was given up.
const FORGOTTEN: u64 = 3_000 * MS;

/// The segment that one reader requests repeatedly.
#[derive(Clone, Copy, Debug, Default)]
pub struct Suspicion {
    missing: Option<Position>,
    times: u32,
    last: u64,
}

impl Suspicion {
    /// Processes a request of the reader. Repairs sent after `too_early` may still be in flight.
    /// Returns true if the reader has requested a segment too often.
    pub fn asked(&mut self, now: u64, missing: &[Missing], too_early: u64) -> bool {
        let covers = |range: &Missing, at: Position| {
            range.sequence == at.sequence && range.first <= at.index && range.last().is_none_or(|last| at.index <= last)
        };
        let again = self.missing.is_some_and(|at| missing.iter().any(|range| covers(range, at)));
        if again && self.last <= too_early {
            (self.times, self.last) = (self.times + 1, now);
        } else if !again && (self.missing.is_none() || now.saturating_sub(self.last) > FORGOTTEN) {
            let first = missing.first().map(|range| Position { sequence: range.sequence, index: range.first });
            *self = Self { missing: first, times: 1, last: now };
        }
        let found = self.times >= ASKED;
        if found {
            *self = Self::default();
        }
        found
    }

    /// Processes the arrival of a frame with a payload of `bytes` bytes.
    pub fn on_received(&mut self, bytes: usize) {
        if bytes > LEAST_PAYLOAD {
            *self = Self::default();
        }
    }
}

/// The limit on the frame size of a topic, caused by its readers.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameLimit {
    until: u64,
    time: u64,
}

impl FrameLimit {
    pub fn max_payload(&self, now: u64) -> usize {
        if now < self.until { LEAST_PAYLOAD } else { usize::MAX }
    }

    /// Limits the frame size, because large frames are lost on the path to a reader.
    pub fn set(&mut self, now: u64) {
        if now >= self.until {
            self.time = (2 * self.time).clamp(SMALL_TIME, LONGEST_SMALL_TIME);
            self.until = now + self.time;
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/transport/black_hole.rs"]
mod tests;
