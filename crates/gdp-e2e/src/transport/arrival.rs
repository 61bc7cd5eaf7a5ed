//! The inputs and reports of an inbound topic.

use crate::feedback_wire::Feedback;
use crate::seal::SegmentId;
use crate::transport::{MS, Position};
use serde::Serialize;

/// The delivery order that a reader requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Delivers each message when it is complete, if it is newer than the previous ones. For
    /// best-effort topics.
    Newest,
    /// Delivers all messages in sequence. For reliable topics.
    Every,
}

#[derive(Clone, Copy, Debug)]
pub struct InboundOptions {
    pub order: Order,
    /// A message that is incomplete this many nanoseconds after its first sign is given up.
    pub deadline: u64,
    /// Maximum number of messages that are incomplete or wait for an earlier one.
    pub messages: usize,
    /// Maximum bytes of messages that wait for an earlier one, and of the state of incomplete ones.
    pub bytes: usize,
    /// Number of unreported messages that cause an early report.
    pub report_after: u64,
}

impl InboundOptions {
    pub fn newest() -> Self {
        Self { order: Order::Newest, deadline: 200 * MS, messages: 64, bytes: 16 << 20, report_after: u64::MAX }
    }

    pub fn every() -> Self {
        let deadline = 30_000 * MS;
        Self { order: Order::Every, deadline, messages: 1024, bytes: 64 << 20, report_after: u64::MAX }
    }

    /// Returns options for all messages of a writer that retains the last `history` of them. The
    /// writer learns what has arrived before its history is full.
    pub fn every_of(history: u32) -> Self {
        Self { report_after: u64::from(history / 4).max(1), ..Self::every() }
    }
}

/// A segment that opened under the session's key.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    pub position: Position,
    pub cut: u16,
    /// Number of segments of the message.
    pub total: u32,
    /// Bytes of the segment in the frame, including its header.
    pub bytes: usize,
}

impl Segment {
    /// Returns the parts of a sealed segment, one for each message. The first one has its bytes.
    pub fn of(id: &SegmentId) -> impl Iterator<Item = Self> + use<> {
        let SegmentId { cut, index, count: total, len, .. } = *id;
        let positions = (id.sequence..).take(id.messages as usize).map(move |sequence| Position { sequence, index });
        positions.zip(std::iter::once(len).chain(std::iter::repeat(0))).map(move |(position, bytes)| Self {
            position,
            cut,
            total,
            bytes,
        })
    }
}

/// An output of an inbound topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Arrival<M> {
    Message(M),
    /// Feedback to send to the writer.
    Feedback(Feedback),
}

/// The outcomes of a session's messages. `delivered` and the next three counters cover all messages
/// up to the last settled one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct InboundCounters {
    pub delivered: u64,
    /// Best effort: incomplete when a newer message was complete.
    pub overtaken: u64,
    /// Incomplete at the deadline.
    pub expired: u64,
    /// Reliable: the writer no longer has the message, or there was no room to wait for it.
    pub abandoned: u64,
    /// Segments that were already received, or belong to a settled message.
    pub duplicates: u64,
    /// Segments beyond the limit of outstanding messages. The writer sends them again.
    pub beyond: u64,
}
