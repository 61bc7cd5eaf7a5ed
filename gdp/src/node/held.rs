//! Frames from a writer that is not known yet. A writer begins as soon as its switch lets it, which can be before its
//! readers were told of it: what it sends until then waits here, for a moment and within a fixed amount of memory, and is
//! looked into only once the writer's certificates were verified.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use gdp_wire::Name;

/// How long a frame waits.
const PATIENCE: Duration = Duration::from_secs(1);

/// Payload bytes that wait, of all names together: the first message of a camera should fit.
const MAX_BYTES: usize = 2 << 20;

/// What a frame costs beside its payload, roughly.
const OVERHEAD: usize = 128;

#[derive(Default)]
pub struct Held {
    /// The oldest first.
    frames: VecDeque<HeldFrame>,
    bytes: usize,
}

pub struct HeldFrame {
    since: Instant,
    name: Name,
    pub source: Name,
    pub payload: Vec<u8>,
}

impl HeldFrame {
    fn cost(&self) -> usize {
        self.payload.len() + OVERHEAD
    }
}

impl Held {
    /// Keeps a copy of the payload, if there is room.
    pub fn hold(&mut self, name: Name, source: Name, payload: &[u8]) -> bool {
        if self.bytes + payload.len() + OVERHEAD > MAX_BYTES {
            return false;
        }
        let frame = HeldFrame { since: Instant::now(), name, source, payload: payload.to_vec() };
        self.bytes += frame.cost();
        self.frames.push_back(frame);
        true
    }

    /// The frames for `name` from sources that are known by now, in the order of their arrival.
    pub fn release(&mut self, name: &Name, known: impl Fn(&Name) -> bool) -> Vec<HeldFrame> {
        let (released, kept): (Vec<_>, Vec<_>) =
            self.frames.drain(..).partition(|frame| frame.name == *name && known(&frame.source));
        self.bytes -= released.iter().map(HeldFrame::cost).sum::<usize>();
        self.frames = kept.into();
        released
    }

    /// Gives up frames that waited too long; returns how many.
    pub fn expire(&mut self) -> u64 {
        let mut expired = 0;
        while self.frames.front().is_some_and(|frame| frame.since.elapsed() >= PATIENCE) {
            self.bytes -= self.frames.pop_front().map_or(0, |frame| frame.cost());
            expired += 1;
        }
        expired
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_released_in_order_and_only_for_their_name_and_source() {
        let (name, other) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]));
        let mut held = Held::default();
        for i in 0..4 {
            assert!(held.hold(name, name, &[i]) && held.hold(other, name, &[9]) && held.hold(name, other, &[9]));
        }
        let released = held.release(&name, |source| *source == name);
        assert_eq!(released.iter().map(|frame| frame.payload[0]).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!((held.frames.len(), held.bytes), (8, 8 * (OVERHEAD + 1)));
        assert_eq!(held.release(&name, |_| true).len() + held.release(&other, |_| true).len(), 8);
        assert_eq!((held.frames.len(), held.bytes), (0, 0));
    }

    #[test]
    fn memory_is_bounded() {
        let mut held = Held::default();
        let count = (0..100_000).filter(|_| held.hold(Name::default(), Name::default(), &[])).count();
        assert_eq!(count, MAX_BYTES / OVERHEAD);
        assert_eq!(held.expire(), 0, "nothing waited for long");
    }
}
