//! A way that swallows large frames without a word, as when a tunnel on it takes less than its ends
//! know: what a reader asks for comes never, while what is small does. Such a topic sends small
//! frames for a while, and then tries large ones again (after RFC 8899, §4.3).

use gdp_wire::Header;

use super::{MS, Position};
use crate::feedback_wire::Missing;
use gdp_wire::SMALLEST_PATH;

/// What every way takes, in bytes of a frame's payload.
pub const LEAST_PAYLOAD: usize = SMALLEST_PATH as usize - Header::LEN;

/// A reader that asks so often for the same is thought to be behind such a way, if nothing large
/// has come meanwhile.
const ASKED: u32 = 5;

/// How long only small frames go, at first; twice as long each time.
const SMALL_TIME: u64 = 30_000 * MS;
const LONGEST_SMALL_TIME: u64 = 600_000 * MS;

/// What is not asked for again for so long has come, or was given up.
const FORGOTTEN: u64 = 3_000 * MS;

/// What one reader asks for again and again.
#[derive(Clone, Copy, Debug, Default)]
pub struct Suspicion {
    missing: Option<Position>,
    times: u32,
    last: u64,
}

impl Suspicion {
    /// The reader asks for these; what was repaired later than `too_early` may still be on its way.
    /// True if something is asked for once too often.
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

    /// A frame with a payload of so many bytes has come.
    pub fn on_received(&mut self, bytes: usize) {
        if bytes > LEAST_PAYLOAD {
            *self = Self::default();
        }
    }
}

/// How large the frames of a topic may be on account of its readers.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameLimit {
    until: u64,
    time: u64,
}

impl FrameLimit {
    pub fn max_payload(&self, now: u64) -> usize {
        if now < self.until { LEAST_PAYLOAD } else { usize::MAX }
    }

    /// Large frames vanish on the way to a reader.
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
