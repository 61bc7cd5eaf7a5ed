//! The inputs, outputs and limits of a reader of sealed messages.

use crate::seal::DropReason;
use crate::seal::message::Message;
use crate::seal::segment::SegmentId;
use gdp_core::crypto::Backend;
use gdp_core::name::Name;
use std::time::Duration;

/// A time on the two clocks that a reader needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timestamps {
    /// Nanoseconds of any monotonic clock, for deadlines.
    pub steady_ns: u64,
    /// Nanoseconds since the Unix epoch, for the age of signatures.
    pub unix_ns: u64,
}

/// The writer's signed statement about the progress of its session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    pub session: [u8; 16],
    /// The sequence of the next message.
    pub next: u64,
    /// Messages before this one are no longer available.
    pub oldest: u64,
    /// Unix time on the writer's clock.
    pub timestamp_ns: u64,
}

/// A message with received segments that was dropped without delivery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost {
    pub session: [u8; 16],
    pub sequence: u64,
    /// The message can still be delivered if all segments are sent again. Its segments were
    /// evicted, or some of them were not the writer's.
    pub again: bool,
}

/// One call of [`Reader::push`], for the state of its writer.
pub struct Push<'a> {
    pub shared: &'a mut ReaderContext,
    pub scratch: &'a mut [u8],
    pub now: Timestamps,
    pub out: &'a mut Received,
}

/// The resources that a reader grants its writers, and its acceptance limits.
#[derive(Clone, Copy, Debug)]
pub struct ReaderLimits {
    /// Bytes of a message body.
    pub max_message: usize,
    /// Bytes of incomplete messages of one writer, including bookkeeping.
    pub max_memory_per_source: usize,
    /// Bytes of incomplete messages of all writers.
    pub max_memory: usize,
    /// Maximum time between the first segment of a message and its completion.
    pub deadline: Duration,
    /// Maximum age of a signature. The clocks of writers and readers must not differ by more.
    pub max_age: Duration,
    /// Sessions per writer with a replay window. The same number of unconfirmed sessions is
    /// permitted in addition.
    pub max_sessions: usize,
}

impl Default for ReaderLimits {
    fn default() -> Self {
        Self {
            max_message: 64 << 20,
            max_memory_per_source: 128 << 20,
            max_memory: 512 << 20,
            deadline: Duration::from_secs(1),
            max_age: Duration::from_secs(300),
            max_sessions: 8,
        }
    }
}

/// The output of received payloads. The caller owns it, clears it and reuses it.
#[derive(Debug, Default)]
pub struct Received {
    /// Verified messages, in the order of completion.
    pub messages: Vec<Message>,
    /// Verified heartbeats, each newer than the previous one of its session.
    pub heartbeats: Vec<Heartbeat>,
    /// Newly received segments of messages that opened under the key. Any holder of the key may
    /// have made them. The writer is proven only when the message is complete.
    pub segments: Vec<SegmentId>,
    /// Segments that opened but are not needed: they were already received, or their message was
    /// delivered.
    pub repeated: Vec<SegmentId>,
    /// Lost messages, except those that missed [`ReaderLimits::deadline`], which the caller
    /// handles.
    pub lost: Vec<Lost>,
    /// Something that the writer has signed was older than [`ReaderLimits::max_age`]. It was late,
    /// or the clocks differ.
    pub too_old: bool,
}

impl Received {
    pub fn clear(&mut self) {
        self.messages.clear();
        self.heartbeats.clear();
        self.segments.clear();
        self.repeated.clear();
        self.lost.clear();
        self.too_old = false;
    }
}

/// The state that all writers of a name share in a reader.
pub struct ReaderContext {
    pub name: Name,
    pub backend: Backend,
    pub limits: ReaderLimits,
    /// Bytes charged to all assemblies.
    pub memory: usize,
    pub drops: [u64; DropReason::COUNT],
    /// No assembly has an earlier deadline.
    pub next_deadline: u64,
}

impl ReaderContext {
    pub fn count(&mut self, reason: DropReason, times: u64) {
        self.drops[reason as usize] += times;
    }
}
