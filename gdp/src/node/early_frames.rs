//! Frames that came too early: from a writer that is not known yet, under a key that is not here
//! yet, of a session that the writer has yet to confirm. A writer begins as soon as its
//! switch lets it, which can be before its readers were told of it: what it sends until then waits
//! here, for a moment and within a fixed amount of memory.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use gdp_wire::Name;

use gdp_e2e::seal::DropReason;

/// How long a frame waits.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Payload bytes that wait, of all names together: the first message of a camera should fit.
const MAX_BYTES: usize = 2 << 20;

/// What a frame costs beside its payload, roughly.
const OVERHEAD: usize = 128;

#[derive(Default)]
pub struct EarlyFrames {
    /// The oldest first.
    frames: VecDeque<PendingFrame>,
    bytes: usize,
}

pub struct PendingFrame {
    since: Instant,
    name: Name,
    pub source: Name,
    pub payload: Vec<u8>,
    pub marked: bool,
    /// Why it waits, and for how many drops it counts if that was in vain.
    why: (DropReason, u64),
}

impl PendingFrame {
    fn cost(&self) -> usize {
        self.payload.len() + OVERHEAD
    }
}

impl EarlyFrames {
    /// Keeps a copy of the payload; `false` if there is no room.
    pub fn keep(&mut self, (name, source): (Name, Name), payload: &[u8], marked: bool, why: (DropReason, u64)) -> bool {
        if self.bytes + payload.len() + OVERHEAD > MAX_BYTES {
            return false;
        }
        let frame = PendingFrame { since: Instant::now(), name, source, payload: payload.to_vec(), marked, why };
        self.bytes += frame.cost();
        self.frames.push_back(frame);
        true
    }

    /// One that was released, and is still too early, for another reason perhaps; as long as it has
    /// waited in all counts.
    pub fn keep_again(&mut self, frame: PendingFrame, why: (DropReason, u64)) {
        self.bytes += frame.cost();
        let at = self.frames.partition_point(|other| other.since <= frame.since);
        self.frames.insert(at, PendingFrame { why, ..frame });
    }

    /// The frames of a source for `name`, in the order of their arrival.
    pub fn release(&mut self, name: &Name, source: &Name) -> Vec<PendingFrame> {
        let (released, left): (Vec<_>, Vec<_>) =
            self.frames.drain(..).partition(|frame| frame.name == *name && frame.source == *source);
        self.bytes -= released.iter().map(PendingFrame::cost).sum::<usize>();
        self.frames = left.into();
        released
    }

    /// The next frame that waited too long: of which name, why it waited, and for how many drops it
    /// counts.
    pub fn next_expired(&mut self) -> Option<(Name, (DropReason, u64))> {
        let frame = self.frames.pop_front_if(|frame| frame.since.elapsed() >= TIMEOUT)?;
        self.bytes -= frame.cost();
        Some((frame.name, frame.why))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/early_frames.rs"]
mod tests;
