//! What an application asks of a name that it publishes or reads.

use std::time::Duration;

pub use gdp_e2e::feedback_wire::Wants;
pub use gdp_e2e::keys::Rotation;
use gdp_e2e::seal::ReaderLimits;
use gdp_e2e::transport;
use gdp_e2e::transport::{History, InboundOptions, Order, TopicOptions};

/// What a publisher promises its readers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// The newest message: of those that wait for their turn older ones give way, and of one that
    /// is older than `lifetime` nothing more is sent.
    BestEffort { lifetime: Duration },
    /// Every message, in order, as long as the history has it.
    Reliable { overflow: Overflow },
}

/// What happens when the history is full of messages that a reader still lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// [`Publisher::send`](super::Publisher::send) waits; for a reader that falls behind a while at
    /// most.
    Block,
    /// The oldest message goes, and is counted.
    DropOldest,
}

/// How a name is published.
#[derive(Clone, Copy, Debug)]
pub struct PublishOptions {
    pub reliability: Reliability,
    /// Messages kept. Best effort: those that have not begun to go. Reliable: all that may be asked
    /// for again.
    pub history: usize,
    /// Bytes of them, sealed.
    pub history_bytes: usize,
    /// Traffic class, 0 to 7: higher ones go first.
    pub class: u8,
    /// Each frame goes by two of the node's links, if so many are up: nothing is missed when one
    /// fails. Readers take the first of the two.
    pub duplicate: bool,
    /// How many of the last messages of each origin a reader that comes later is sent, sealed for
    /// it anew. Of origins, the last 1024 that sent something.
    /// [`Publisher::latch`](super::Publisher::latch) says it for one origin.
    pub latched: usize,
    /// When the content key is replaced though nobody was revoked.
    pub rotation: Rotation,
}

impl PublishOptions {
    /// The newest message, for half a second.
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

    /// Every message; the last 1024 may be asked for again, and the publisher waits when they are
    /// not enough.
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
            Reliability::Reliable { overflow: Overflow::DropOldest } => {
                transport::Reliability::Reliable { overflow: transport::Overflow::DropOldest }
            }
        };
        let history = History { messages: options.history, bytes: options.history_bytes };
        Self { reliability, history, class: options.class, doubled: options.duplicate }
    }
}

/// How a name is read.
#[derive(Clone, Copy, Debug)]
pub struct SubscribeOptions {
    /// Of publishers that are reliable, and if it is not only the newest that is wanted: every
    /// message in its order, asked for again if it does not come. Otherwise each as soon as it is
    /// complete, if it is newer than those before. Where every message is wanted, publishers that
    /// are not reliable are incompatible, and counted.
    pub wants: Wants,
    /// It comes by each of the node's links, and what comes twice is dropped: nothing is missed
    /// when one fails, as long as its frames fit each of them. Otherwise it comes by the main one.
    pub duplicate: bool,
    /// For messages that are not complete yet, and for how old they may be.
    pub limits: ReaderLimits,
    /// Complete messages that wait for [`Subscription::recv`](super::Subscription::recv). More are
    /// dropped and counted; those of reliable names wait at their publisher.
    pub queue: usize,
    /// Bytes of their bodies.
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

    /// Every message of publishers that are reliable, and the newest of others.
    pub fn as_offered() -> Self {
        Self { wants: Wants::Offered, ..Self::reliable() }
    }
}

impl SubscribeOptions {
    /// Of one writer's session. `reliable`: both want every message.
    pub(super) fn inbound(&self, reliable: bool) -> InboundOptions {
        if reliable {
            return InboundOptions::every();
        }
        let ReaderLimits { deadline, max_memory_per_source, .. } = self.limits;
        // One that asks for every message would wait too long for each of a writer that keeps none.
        let deadline = if self.wants != Wants::Newest { ReaderLimits::default().deadline } else { deadline };
        let newest = InboundOptions::newest();
        InboundOptions { order: Order::Newest, deadline: nanos(deadline), bytes: max_memory_per_source, ..newest }
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Of topics, by default. The clocks of writers and readers must not differ by more.
const MAX_AGE: Duration = Duration::from_secs(10);
/// Of those that are reliable: a message may wait for a link to come back.
const MAX_RELIABLE_AGE: Duration = Duration::from_secs(60);
