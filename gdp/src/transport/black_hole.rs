//! A way that swallows large frames without a word, as when a tunnel on it takes less than its ends know: what a reader asks for
//! comes never, while what is small does. Such a topic sends small frames for a while, and then tries large ones again
//! (after RFC 8899, §4.3).

use gdp_wire::Header;

use super::{MS, Position};
use crate::port::SMALLEST_PATH;

/// What every way takes, in bytes of a frame's payload.
pub const LEAST_PAYLOAD: usize = SMALLEST_PATH as usize - Header::LEN;

/// A reader that asks so often for the same is thought to be behind such a way, if nothing large has come meanwhile.
const ASKED: u32 = 5;

/// How long only small frames go, at first; twice as long each time.
const SMALL_TIME: u64 = 30_000 * MS;
const LONGEST_SMALL_TIME: u64 = 600_000 * MS;

/// What one reader asks for again and again.
#[derive(Clone, Copy, Debug, Default)]
pub struct Suspicion {
    missing: Option<Position>,
    times: u32,
    last: u64,
}

impl Suspicion {
    /// The reader asks for this, the first that it lacks; what was repaired later than `too_early` may still be on its way. True if
    /// that is once too often.
    pub fn asked(&mut self, now: u64, missing: Position, too_early: u64) -> bool {
        if self.missing != Some(missing) {
            *self = Self { missing: Some(missing), times: 1, last: now };
        } else if self.last <= too_early {
            (self.times, self.last) = (self.times + 1, now);
        }
        let found = self.times >= ASKED;
        if found {
            *self = Self::default();
        }
        found
    }

    /// A frame with a payload of so many bytes has come.
    pub fn came(&mut self, bytes: usize) {
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
mod tests {
    use super::*;

    const FIRST: Position = Position { sequence: 1, index: 0 };

    #[test]
    fn only_what_is_asked_for_in_vain_again_and_again_is_suspicious() {
        let mut suspicion = Suspicion::default();
        let mut ask = |at: u64, sequence, rtt: u64| {
            suspicion.asked(at * MS, Position { sequence, ..FIRST }, (at * MS).saturating_sub(rtt * MS))
        };
        assert!((0..100).all(|at| !ask(at, at, 0)), "always another");
        assert!((100..119).all(|at| !ask(at, 1, 20)), "within a round trip");
        assert_eq!((12..20).map(|n| ask(n * 10, 1, 5)).position(|found| found), Some(3));
        let mut suspicion = Suspicion::default();
        for at in 0..100 {
            assert!(!suspicion.asked(at, FIRST, at));
            if at % 3 == 0 {
                suspicion.came(LEAST_PAYLOAD + 1);
            }
            suspicion.came(LEAST_PAYLOAD);
        }
    }

    #[test]
    fn large_frames_are_tried_again_and_less_and_less_often() {
        let (mut limit, mut now, mut times) = (FrameLimit::default(), 5, Vec::new());
        assert_eq!(limit.max_payload(now), usize::MAX);
        for _ in 0..7 {
            limit.set(now);
            limit.set(now + 1);
            let until = limit.until;
            assert_eq!((limit.max_payload(until - 1), limit.max_payload(until)), (LEAST_PAYLOAD, usize::MAX));
            times.push((until - now) / (1000 * MS));
            now = until;
        }
        assert_eq!(times, [30, 60, 120, 240, 480, 600, 600]);
    }
}
