//! Frames that came too early: from a writer that is not known yet, under a key that is not here yet, of a session that the writer
//! has yet to vouch for. A writer begins as soon as its switch lets it, which can be before its readers were told of it: what it
//! sends until then waits here, for a moment and within a fixed amount of memory.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use gdp_wire::Name;

use crate::seal::DropReason;

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
    pub marked: bool,
    /// Why it waits, and for how many drops it counts if that was in vain.
    why: (DropReason, u64),
}

impl HeldFrame {
    fn cost(&self) -> usize {
        self.payload.len() + OVERHEAD
    }
}

impl Held {
    /// Keeps a copy of the payload; `false` if there is no room.
    pub fn hold(&mut self, (name, source): (Name, Name), payload: &[u8], marked: bool, why: (DropReason, u64)) -> bool {
        if self.bytes + payload.len() + OVERHEAD > MAX_BYTES {
            return false;
        }
        let frame = HeldFrame { since: Instant::now(), name, source, payload: payload.to_vec(), marked, why };
        self.bytes += frame.cost();
        self.frames.push_back(frame);
        true
    }

    /// One that was released, and is still too early, for another reason perhaps; as long as it has waited in all counts.
    pub fn hold_again(&mut self, frame: HeldFrame, why: (DropReason, u64)) {
        self.bytes += frame.cost();
        let at = self.frames.partition_point(|other| other.since <= frame.since);
        self.frames.insert(at, HeldFrame { why, ..frame });
    }

    /// The frames of a source for `name`, in the order of their arrival.
    pub fn release(&mut self, name: &Name, source: &Name) -> Vec<HeldFrame> {
        let (released, kept): (Vec<_>, Vec<_>) =
            self.frames.drain(..).partition(|frame| frame.name == *name && frame.source == *source);
        self.bytes -= released.iter().map(HeldFrame::cost).sum::<usize>();
        self.frames = kept.into();
        released
    }

    /// The next frame that waited too long: of which name, why it waited, and for how many drops it counts.
    pub fn next_expired(&mut self) -> Option<(Name, (DropReason, u64))> {
        let frame = self.frames.pop_front_if(|frame| frame.since.elapsed() >= PATIENCE)?;
        self.bytes -= frame.cost();
        Some((frame.name, frame.why))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHY: (DropReason, u64) = (DropReason::NoKey, 1);

    #[test]
    fn frames_are_released_in_order_and_only_for_their_name_and_source() {
        let (name, other) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]));
        let mut held = Held::default();
        for i in 0..4 {
            for (name, source, byte) in [(name, name, i), (other, name, 9), (name, other, 9)] {
                assert!(held.hold((name, source), &[byte], false, WHY));
            }
        }
        let released = held.release(&name, &name);
        assert_eq!(released.iter().map(|frame| frame.payload[0]).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!((held.frames.len(), held.bytes), (8, 8 * (OVERHEAD + 1)));
        released.into_iter().rev().for_each(|frame| held.hold_again(frame, WHY));
        assert!(held.frames.iter().is_sorted_by_key(|frame| frame.since));
        let again = held.release(&name, &name);
        assert_eq!(again.iter().map(|frame| frame.payload[0]).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(held.release(&name, &other).len() + held.release(&other, &name).len(), 8);
        assert_eq!((held.frames.len(), held.bytes), (0, 0));
    }

    #[test]
    fn memory_is_bounded_and_what_finds_no_room_is_not_held() {
        let mut held = Held::default();
        let most = MAX_BYTES / OVERHEAD;
        let taken = (0..100_000).filter(|_| held.hold((Name::default(), Name::default()), &[], false, WHY)).count();
        assert_eq!(taken, most);
        assert_eq!((held.frames.len(), held.bytes), (most, most * OVERHEAD));
        assert_eq!(held.next_expired(), None, "nothing waited for long");
    }
}
