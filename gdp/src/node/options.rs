//! The options of a name that an application publishes or reads.

use std::time::Duration;

pub use gdp_e2e::feedback_wire::Wants;
pub use gdp_e2e::keys::Rotation;
use gdp_e2e::seal::ReaderLimits;
use gdp_e2e::transport;
use gdp_e2e::transport::{History, InboundOptions, Order, TopicOptions};

/// The reliability that a publisher offers its readers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// The newest message. Newer messages replace queued ones, and a message older than `lifetime`
    /// is not sent any further.
    BestEffort { lifetime: Duration },
    /// Every message, in order, as long as the history contains it.
    Reliable { overflow: Overflow },
}

/// The action when the history is full of messages that a reader still lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// [`Publisher::send`](super::Publisher::send) waits. For a reader that falls behind, it waits
    /// for a limited time only.
    Block,
    /// Drops and counts the oldest message. A message of 64 kB or more also gives way when it is
    /// older than a second, newer ones wait, and `keep_last` newer ones supersede it.
    DropOldest { keep_last: usize },
}

/// The options of a publication.
#[derive(Clone, Copy, Debug)]
pub struct PublishOptions {
    pub reliability: Reliability,
    /// Maximum number of stored messages. Best effort: those whose transmission has not started.
    /// Reliable: those that readers may request again.
    pub history: usize,
    /// Maximum size of the stored messages, sealed, in bytes.
    pub history_bytes: usize,
    /// Traffic class, 0 to 7. Higher classes are sent first.
    pub class: u8,
    /// Whether each frame is sent on two of the node's links, if two are up. No message is lost
    /// when one of them fails. Readers use the first of the two frames.
    pub duplicate: bool,
    /// Number of latched messages per origin for late-joining readers, sealed again for them.
    /// Applies to the 1024 most recent origins. [`Publisher::latch`](super::Publisher::latch) sets
    /// it for one origin.
    pub latched: usize,
    /// The schedule for replacing the content key without a revocation.
    pub rotation: Rotation,
}

impl PublishOptions {
    /// Offers the newest message, for half a second.
    pub fn best_effort() -> Self {
        Self {
            reliability: Reliability::BestEffort { lifetime: Duration::from_millis(500) },
            history: 8,
            history_bytes: 64 << 20,
            class: 3,
            duplicate: false,
            latched: 0,
            rotation: Rotation::default(),
        }
    }

    /// Offers every message. Readers may request the last 1024 again, and the publisher waits when
    /// the history is full.
    pub fn reliable() -> Self {
        let reliability = Reliability::Reliable { overflow: Overflow::Block };
        Self { reliability, history: 1024, ..Self::best_effort() }
    }
}

impl From<PublishOptions> for TopicOptions {
    fn from(options: PublishOptions) -> Self {
        let reliability = match options.reliability {
            Reliability::BestEffort { lifetime } => transport::Reliability::BestEffort { lifetime: nanos(lifetime) },
            Reliability::Reliable { overflow: Overflow::Block } => {
                transport::Reliability::Reliable { overflow: transport::Overflow::Block }
            }
            Reliability::Reliable { overflow: Overflow::DropOldest { keep_last } } => {
                transport::Reliability::Reliable { overflow: transport::Overflow::DropOldest { keep_last } }
            }
        };
        let history = History { messages: options.history, bytes: options.history_bytes };
        Self { reliability, history, class: options.class, doubled: options.duplicate }
    }
}

/// The options of a subscription.
#[derive(Clone, Copy, Debug)]
pub struct SubscribeOptions {
    /// Which messages the subscription requests.
    ///
    /// From reliable publishers, unless only the newest is requested: every message in order, with
    /// retransmission. Otherwise each message as soon as it is complete, if it is newer than those
    /// before. If every message is requested, publishers that are not reliable count as
    /// incompatible.
    pub wants: Wants,
    /// Whether each of the node's links delivers the name; the node drops duplicates. No message is
    /// lost when one link fails, as long as the frames fit every link. Otherwise the main link
    /// delivers it.
    pub duplicate: bool,
    /// Limits of incomplete messages and of the age of messages.
    pub limits: ReaderLimits,
    /// Maximum number of complete messages that wait for
    /// [`Subscription::recv`](super::Subscription::recv). Excess messages are dropped and counted;
    /// those of reliable names wait at their publisher.
    pub queue: usize,
    /// Maximum size of their bodies, in bytes.
    pub queue_bytes: usize,
}

impl SubscribeOptions {
    pub fn best_effort() -> Self {
        let limits = ReaderLimits { max_age: MAX_AGE, ..ReaderLimits::default() };
        Self { wants: Wants::Newest, duplicate: false, limits, queue: 256, queue_bytes: 64 << 20 }
    }

    pub fn reliable() -> Self {
        let limits = ReaderLimits { max_age: MAX_RELIABLE_AGE, deadline: MAX_RELIABLE_AGE, ..ReaderLimits::default() };
        Self { wants: Wants::Every, limits, ..Self::best_effort() }
    }

    /// Requests every message of reliable publishers, and the newest of others.
    pub fn as_offered() -> Self {
        Self { wants: Wants::Offered, ..Self::reliable() }
    }
}

impl SubscribeOptions {
    /// Returns the options for one writer's session. `history`: both sides want every message, and
    /// the writer retains so many.
    pub(super) fn inbound(&self, history: Option<u32>) -> InboundOptions {
        if let Some(history) = history {
            return InboundOptions::every_of(history);
        }
        let ReaderLimits { deadline, max_memory_per_source, .. } = self.limits;
        // A subscription that requests every message would wait too long for a writer that stores
        // none.
        let deadline = if self.wants != Wants::Newest { ReaderLimits::default().deadline } else { deadline };
        let newest = InboundOptions::newest();
        InboundOptions { order: Order::Newest, deadline: nanos(deadline), bytes: max_memory_per_source, ..newest }
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Default maximum age of messages. The clocks of writers and readers must not differ by more.
const MAX_AGE: Duration = Duration::from_secs(10);
/// Default maximum age with reliability: a message may wait for a link to return.
const MAX_RELIABLE_AGE: Duration = Duration::from_secs(60);
