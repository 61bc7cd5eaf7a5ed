//! A way that swallows large frames without a word, as when a tunnel on it takes less than its ends know: what a reader asks for
//! comes never, while what is small does. Such a topic sends small frames for a while, and then tries large ones again
//! (after RFC 8899, §4.3).

use gdp_wire::Header;

use super::{MS, Position};
use crate::feedback_wire::Missing;
use crate::port::SMALLEST_PATH;

/// What every way takes, in bytes of a frame's payload.
pub const LEAST_PAYLOAD: usize = SMALLEST_PATH as usize - Header::LEN;

/// A reader that asks so often for the same is thought to be behind such a way, if nothing large has come meanwhile.
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
    /// The reader asks for these; what was repaired later than `too_early` may still be on its way. True if something is asked for
    /// once too often.
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

    #[test]
    fn only_what_is_asked_for_in_vain_again_and_again_is_suspicious() {
        let mut suspicion = Suspicion::default();
        let mut ask = |at: u64, sequences: &[u64], rtt: u64| {
            let missing: Vec<_> = sequences.iter().map(|sequence| Missing::whole(*sequence)).collect();
            suspicion.asked(at * MS, &missing, (at * MS).saturating_sub(rtt * MS))
        };
        assert!((0..100).all(|at| !ask(at, &[at], 0)), "always another");
        assert!((4000..4019).all(|at| !ask(at, &[1000], 20)), "within a round trip");
        // It is among others, and not always.
        let found = (4020..4060).map(|at| ask(at, if at % 2 == 0 { &[1000, 1001] } else { &[1002] }, 5));
        assert_eq!(found.filter(|found| *found).count(), 1);

        let mut suspicion = Suspicion::default();
        for at in 0..100 {
            assert!(!suspicion.asked(at, &[Missing::whole(1)], at));
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
