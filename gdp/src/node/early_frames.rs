//! Buffers frames that arrive too early.
//!
//! Such frames come from an unknown writer, use an unknown key, or belong to a session that the
//! writer has yet to confirm. A writer starts as soon as its switch allows it, possibly before its
//! readers know of it. Its frames wait here for a short time and within a fixed amount of memory.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use gdp_wire::Name;

use gdp_e2e::seal::DropReason;

/// Time for which a frame waits.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Limit of the buffered payload bytes of all names. It should fit the first message of a camera.
const MAX_BYTES: usize = 2 << 20;

/// Approximate memory per frame besides its payload.
const OVERHEAD: usize = 128;

#[derive(Default)]
pub struct EarlyFrames {
    /// Oldest first.
    frames: VecDeque<PendingFrame>,
    bytes: usize,
}

pub struct PendingFrame {
    since: Instant,
    name: Name,
    pub source: Name,
    pub payload: Vec<u8>,
    pub marked: bool,
    /// Why the frame waits, and the number of drops to count if it expires.
    why: (DropReason, u64),
}

impl PendingFrame {
    fn cost(&self) -> usize {
        self.payload.len() + OVERHEAD
    }
}

impl EarlyFrames {
    /// Buffers a copy of the payload. Returns `false` if there is no space.
    pub fn keep(&mut self, (name, source): (Name, Name), payload: &[u8], marked: bool, why: (DropReason, u64)) -> bool {
        if self.bytes + payload.len() + OVERHEAD > MAX_BYTES {
            return false;
        }
        let frame = PendingFrame { since: Instant::now(), name, source, payload: payload.to_vec(), marked, why };
        self.bytes += frame.cost();
        self.frames.push_back(frame);
        true
    }

    /// Buffers a released frame that is still too early, perhaps for another reason. The frame's
    /// total waiting time counts.
    pub fn keep_again(&mut self, frame: PendingFrame, why: (DropReason, u64)) {
        self.bytes += frame.cost();
        let at = self.frames.partition_point(|other| other.since <= frame.since);
        self.frames.insert(at, PendingFrame { why, ..frame });
    }

    /// Removes and returns the frames from a source for `name`, in order of arrival.
    pub fn release(&mut self, name: &Name, source: &Name) -> Vec<PendingFrame> {
        let (released, left): (Vec<_>, Vec<_>) =
            self.frames.drain(..).partition(|frame| frame.name == *name && frame.source == *source);
        self.bytes -= released.iter().map(PendingFrame::cost).sum::<usize>();
        self.frames = left.into();
        released
    }

    /// Returns the time when the next frame will have waited too long.
    pub fn next_expiry(&self) -> Option<Instant> {
        self.frames.front().map(|frame| frame.since + TIMEOUT)
    }

    /// Removes the next frame that has waited too long. Returns its name, why it waited, and the
    /// number of drops to count.
    pub fn next_expired(&mut self) -> Option<(Name, (DropReason, u64))> {
        let frame = self.frames.pop_front_if(|frame| frame.since.elapsed() >= TIMEOUT)?;
        self.bytes -= frame.cost();
        Some((frame.name, frame.why))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/early_frames.rs"]
mod tests;
