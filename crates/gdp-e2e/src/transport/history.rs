//! What a topic keeps of its messages, and for whom.

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

/// A message of this size is large, in bytes.
pub const LARGE: usize = 1 << 16;

/// Age in nanoseconds at which a large message becomes stale. A path that is so far behind takes
/// newer messages rather than all frames of old ones.
pub const STALE: u64 = 1_000 * MS;
