//! What an inbound topic is told, and what it reports.

use crate::feedback_wire::Feedback;
use crate::seal::SegmentId;
use crate::transport::{MS, Position};
use serde::Serialize;

/// In which order a reader wants messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Each as soon as it is complete, if it is newer than those before: for topics that are best
    /// effort.
    Newest,
    /// All, one after another: for topics that are reliable.
    Every,
}

#[derive(Clone, Copy, Debug)]
pub struct InboundOptions {
    pub order: Order,
    /// A message that is not complete so many nanoseconds after it became known is given up.
    pub deadline: u64,
    /// Messages that may be incomplete, or wait for one before them.
    pub messages: usize,
    /// Bytes of messages that wait for one before them, and of what is known of incomplete ones.
    pub bytes: usize,
}

impl InboundOptions {
    pub fn newest() -> Self {
        Self { order: Order::Newest, deadline: 200 * MS, messages: 64, bytes: 16 << 20 }
    }

    pub fn every() -> Self {
        Self { order: Order::Every, deadline: 30_000 * MS, messages: 1024, bytes: 64 << 20 }
    }
}

/// A segment that opened under the session's key.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    pub position: Position,
    pub cut: u16,
    /// Segments of the message, its proof included.
    pub total: u32,
    /// In the frame, its header included.
    pub bytes: usize,
}

impl From<&SegmentId> for Segment {
    fn from(id: &SegmentId) -> Self {
        let position = Position { sequence: id.sequence, index: id.index };
        // No message has as many segments; if one does, its last is refused.
        Self { position, cut: id.cut, total: id.count.saturating_add(1), bytes: id.len }
    }
}

/// What comes of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Arrival<M> {
    Message(M),
    /// For the writer.
    Feedback(Feedback),
}

/// What became of a session's messages here. `delivered` and the three after it are all that there
/// are up to the last one dealt with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct InboundCounters {
    pub delivered: u64,
    /// Best effort: incomplete when a newer one was complete.
    pub overtaken: u64,
    /// Not complete at the deadline.
    pub expired: u64,
    /// Reliable: the writer has it no more, or there was no room to wait for it.
    pub abandoned: u64,
    /// Segments that were there, or belong to a message that is dealt with.
    pub duplicates: u64,
    /// Segments beyond what may be outstanding. They come again.
    pub beyond: u64,
}
