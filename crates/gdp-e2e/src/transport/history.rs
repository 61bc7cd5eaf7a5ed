//! What a topic keeps of its messages, and what became of them.

use serde::Serialize;

use super::MS;

/// The delivery guarantee of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// Of waiting messages, sends the newest. Sends no frame of a message that is more than
    /// `lifetime` nanoseconds old.
    BestEffort { lifetime: u64 },
    /// Delivers every message, as long as the history has it.
    Reliable { overflow: Overflow },
}

/// The reaction of a reliable topic to a history full of messages that a reader still lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// The publisher waits. For a reader that falls behind, it waits once and for a limited time.
    Block,
    /// The oldest message is dropped and counted. A large one also gives way when it is
    /// [stale](STALE).
    DropOldest {
        /// Depth of the publisher's history in ROS: this many newer messages supersede a message.
        keep_last: usize,
    },
}

/// The capacity of a topic. A message larger than the capacity is accepted if the history is empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct History {
    /// Best effort: messages that are not yet in progress, where those under one signature count as
    /// one. Reliable: all messages.
    pub messages: usize,
    pub bytes: usize,
}

/// A message of at least this size is large, in bytes. A batch of small ones is not.
pub const LARGE: usize = 1 << 16;

/// Time in nanoseconds after which a large message is stale: since it was published, or since it
/// was sent and only repairs are left. A path that is so far behind takes newer messages.
pub const STALE: u64 = 1_000 * MS;

/// The outcomes of a topic's messages and frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TopicCounters {
    pub messages: u64,
    /// Messages that newer ones replaced before all their frames were sent.
    pub replaced: u64,
    /// Messages whose lifetime ended before all their frames were sent.
    pub expired: u64,
    /// Messages that left the history of a reliable topic before every live reader had them.
    pub evicted: u64,
    /// Frame payloads sent, including repairs. Payloads that share a frame count separately.
    pub frames: u64,
    pub repeated: u64,
    /// Frames that a reader requested beyond its budget.
    pub over_budget: u64,
    /// Frames that readers received with a congestion mark.
    pub marked: u64,
    /// Number of times that a path became congested and its rate was reduced.
    pub slowed: u64,
}
