//! What a reader of sealed messages reports of them.

use crate::seal::DropReason;
use crate::seal::message::Message;
use crate::seal::segment::SegmentId;
use gdp_core::crypto::Backend;
use gdp_core::name::Name;
use std::time::Duration;

/// When something happens, on the two clocks that a reader needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timestamps {
    /// Nanoseconds of any clock that never goes back: for deadlines.
    pub steady_ns: u64,
    /// Nanoseconds since the Unix epoch: for the age of what was signed.
    pub unix_ns: u64,
}

/// The writer's word on how far its session is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    pub session: [u8; 16],
    /// The sequence that the next message will have.
    pub next: u64,
    /// Messages before this one cannot be had again.
    pub oldest: u64,
    /// Unix time on the writer's clock.
    pub timestamp_ns: u64,
}

/// A message whose segments came, and are let go of without a delivery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost {
    pub session: [u8; 16],
    pub sequence: u64,
    /// It may yet be had, if all of it comes once more: these segments gave way to others, or were
    /// not all the writer's.
    pub again: bool,
}

/// One call of [`Reader::push`], as its writer's state sees it.
pub struct Push<'a> {
    pub shared: &'a mut ReaderContext,
    pub scratch: &'a mut [u8],
    pub now: Timestamps,
    pub out: &'a mut Received,
}

/// How much a reader lets its writers use, and what it refuses.
#[derive(Clone, Copy, Debug)]
pub struct ReaderLimits {
    /// Bytes of a message body.
    pub max_message: usize,
    /// Bytes of incomplete messages of one writer, bookkeeping included.
    pub max_memory_per_source: usize,
    /// Bytes of incomplete messages of all writers.
    pub max_memory: usize,
    /// How long after its first segment a message must be complete.
    pub deadline: Duration,
    /// What was signed longer ago is refused. The clocks of writers and readers must not differ by
    /// more.
    pub max_age: Duration,
    /// Sessions per writer whose replay windows are kept, and as many again that the writer has not
    /// vouched for.
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

/// What payloads brought. Kept by the caller, who empties it and reuses it.
#[derive(Debug, Default)]
pub struct Received {
    /// Verified, in the order in which they became complete.
    pub messages: Vec<Message>,
    /// Verified, and each newer than the one before of its session.
    pub heartbeats: Vec<Heartbeat>,
    /// Segments of messages that opened and were not here before. Any holder of the key may have
    /// made them: whether the writer did is known once the message is complete.
    pub segments: Vec<SegmentId>,
    /// Segments that opened and that nothing needs: they are here already, or their message was
    /// delivered.
    pub repeated: Vec<SegmentId>,
    /// But for those that were not complete in time: [`ReaderLimits::deadline`] is the caller's.
    pub lost: Vec<Lost>,
}

impl Received {
    pub fn clear(&mut self) {
        self.messages.clear();
        self.heartbeats.clear();
        self.segments.clear();
        self.repeated.clear();
        self.lost.clear();
    }
}

/// What the writers of a name have in common here.
pub struct ReaderContext {
    pub name: Name,
    pub backend: Backend,
    pub limits: ReaderLimits,
    /// Bytes charged to all assemblies.
    pub memory: usize,
    pub drops: [u64; DropReason::COUNT],
    /// No assembly's deadline is before this.
    pub next_deadline: u64,
}

impl ReaderContext {
    pub fn count(&mut self, reason: DropReason, times: u64) {
        self.drops[reason as usize] += times;
    }
}
