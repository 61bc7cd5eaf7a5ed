//! Counters of a node's frames and messages. The sending tasks and the receiving thread update them
//! without locks.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use gdp_wire::{Counter, ErrorCode};
use serde::Serialize;

use gdp_e2e::seal::DropReason;
use gdp_e2e::transport::{InboundCounters, TopicCounters};

/// Counters that any task can read at any time, also after the counted object is dropped. Clones
/// share the counters.
pub struct Meter<T>(Arc<dyn Fn() -> T + Send + Sync>);

impl<T> Meter<T> {
    pub(super) fn new(read: impl Fn() -> T + Send + Sync + 'static) -> Self {
        Self(Arc::new(read))
    }

    /// Returns the current values.
    pub fn read(&self) -> T {
        (self.0)()
    }
}

impl<T> Clone for Meter<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T: fmt::Debug> fmt::Debug for Meter<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Meter").field(&self.read()).finish()
    }
}

/// A snapshot of a publisher's counters.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PublisherCounters {
    #[serde(flatten)]
    pub topic: TopicCounters,
    /// Attached readers that this node knows of.
    pub readers: usize,
    /// Attached readers that request every message from a best-effort publisher (incompatible QoS
    /// in ROS). They receive the newest messages.
    pub incompatible_readers: usize,
    /// Error reports of the switch about refused frames ([`super::Feedback::errors`]).
    pub refused: BTreeMap<&'static str, u64>,
}

/// A snapshot of a subscription's counters.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SubscriptionCounters {
    #[serde(flatten)]
    pub inbound: InboundCounters,
    /// Delivered messages that the application did not receive in time. None from reliable writers.
    pub queue_full: u64,
    /// Delivered latched messages that were sent again for other readers, and that this reader
    /// already had.
    pub repeats: u64,
    /// Best-effort writers in a subscription that requests every message (incompatible QoS in ROS).
    /// Their newest messages are delivered.
    pub incompatible_writers: usize,
    /// Segments and messages dropped on arrival, by reason ([`DropReason::label`]). Reasons without
    /// drops are omitted.
    pub drops: BTreeMap<&'static str, u64>,
}

/// A monotonic counter.
#[derive(Default)]
pub struct Count(AtomicU64);

impl Count {
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// Copies the value of another counter.
    pub fn set(&self, count: u64) {
        self.0.store(count, Ordering::Relaxed);
    }

    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

#[derive(Default)]
pub struct Counters {
    pub messages_sent: Count,
    pub messages_unsent: Count,
    pub messages_received: Count,
    pub frames_sent: Count,
    pub frames_unsent: Count,
    pub frames_received: Count,
    pub links: Count,
    /// By [`ErrorCode`].
    pub errors: [Count; ErrorCode::COUNT],
    pub echoes_answered: Count,
    /// Frames refused before their payload was examined, by [`Counter`].
    pub refused: [Count; Counter::COUNT],
    /// Frames to a name without a subscription at this node.
    pub not_subscribed: Count,
    /// Messages that the application did not receive in time.
    pub queue_full: Count,
    /// Requests to services that this node does not serve, or from unauthorised callers.
    pub requests_refused: Count,
    /// Frames of reliable names that a reader had no space for; the writers retransmit them.
    pub beyond: Count,
    /// Feedback sent to counterparts and received from them.
    pub feedback_sent: Count,
    pub feedback_received: Count,
    /// Dropped frames to this node's own name, by reason. Unknown: not from a counterpart. Forged:
    /// not sealed by the counterpart. Replayed: already received, for example on another link.
    /// Malformed: not parseable.
    pub feedback_unknown: Count,
    pub feedback_forged: Count,
    pub feedback_replayed: Count,
    pub feedback_malformed: Count,
    /// Segments and messages that a reader dropped, by [`DropReason`].
    pub dropped: [Count; DropReason::COUNT],
}

/// A snapshot of a node's counters.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct NodeCounters {
    pub messages_sent: u64,
    /// Messages refused immediately, without a link or without a right. For the outcome of others
    /// see [`Publisher::counters`](super::Publisher::counters).
    pub messages_unsent: u64,
    pub messages_received: u64,
    pub frames_sent: u64,
    pub frames_unsent: u64,
    /// Frames from the switch, before validation.
    pub frames_received: u64,
    /// Links made so far. All but the first of each lane are reconnections.
    pub links: u64,
    /// Errors from the switch about frames of this node, by error code. Codes without errors are
    /// omitted.
    pub errors_received: BTreeMap<&'static str, u64>,
    /// Echoes from the switch that this node answered.
    pub echoes_answered: u64,
    /// Feedback sent to readers and writers, and received from them. Feedback frames are separate
    /// from message frames.
    pub feedback_sent: u64,
    pub feedback_received: u64,
    /// Frames, segments and messages dropped on arrival, by reason. Reasons without drops are
    /// omitted.
    pub drops: BTreeMap<&'static str, u64>,
}

impl Counters {
    /// Returns a snapshot. `socket_drops` is the number of frames that the kernel dropped before
    /// this process received them.
    pub fn snapshot(&self, socket_drops: u64) -> NodeCounters {
        let refused = Counter::ALL.iter().zip(&self.refused).map(|(counter, count)| (counter.as_str(), count.get()));
        let dropped = DropReason::ALL.iter().zip(&self.dropped).map(|(reason, count)| (reason.label(), count.get()));
        let own = [
            ("drop_not_subscribed", self.not_subscribed.get()),
            ("drop_queue_full", self.queue_full.get()),
            ("drop_socket_full", socket_drops),
            ("drop_request_refused", self.requests_refused.get()),
            ("drop_no_room", self.beyond.get()),
            ("drop_feedback_unknown", self.feedback_unknown.get()),
            ("drop_feedback_forged", self.feedback_forged.get()),
            ("drop_feedback_replayed", self.feedback_replayed.get()),
            ("drop_feedback_malformed", self.feedback_malformed.get()),
        ];
        NodeCounters {
            messages_sent: self.messages_sent.get(),
            messages_unsent: self.messages_unsent.get(),
            messages_received: self.messages_received.get(),
            frames_sent: self.frames_sent.get(),
            frames_unsent: self.frames_unsent.get(),
            frames_received: self.frames_received.get(),
            links: self.links.get(),
            errors_received: by_code(&self.errors),
            echoes_answered: self.echoes_answered.get(),
            feedback_sent: self.feedback_sent.get(),
            feedback_received: self.feedback_received.get(),
            drops: refused.chain(dropped).chain(own).filter(|(_, count)| *count > 0).collect(),
        }
    }
}

/// Returns the counts that are not 0, by the name of their error code.
pub fn by_code(counts: &[Count; ErrorCode::COUNT]) -> BTreeMap<&'static str, u64> {
    let counts = ErrorCode::ALL.iter().zip(counts).map(|(code, count)| (code.as_str(), count.get()));
    counts.filter(|(_, count)| *count > 0).collect()
}
