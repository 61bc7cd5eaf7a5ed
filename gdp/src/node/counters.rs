//! What a node did with frames and messages. Written by the sending tasks and the receiving thread
//! without locks.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use gdp_wire::{Counter, ErrorCode};
use serde::Serialize;

use gdp_e2e::seal::DropReason;
use gdp_e2e::transport::{InboundCounters, TopicCounters};

/// Counters that can be read at any time from any task, also once what they count is gone. Clones
/// are the same.
pub struct Meter<T>(Arc<dyn Fn() -> T + Send + Sync>);

impl<T> Meter<T> {
    pub(super) fn new(read: impl Fn() -> T + Send + Sync + 'static) -> Self {
        Self(Arc::new(read))
    }

    /// As they are at this moment.
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

/// The counters of a publisher at one moment.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PublisherCounters {
    #[serde(flatten)]
    pub topic: TopicCounters,
    /// Attached at this moment, as far as is known here.
    pub readers: usize,
    /// Those of them that ask for every message, where this publisher offers the newest: ROS calls
    /// that incompatible QoS. They get the newest.
    pub incompatible_readers: usize,
    /// What the switch said of frames that it refused ([`super::Feedback::errors`]).
    pub refused: BTreeMap<&'static str, u64>,
}

/// The counters of a subscription at one moment.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SubscriptionCounters {
    #[serde(flatten)]
    pub inbound: InboundCounters,
    /// Of those delivered, what the application did not take in time; none of a reliable writer.
    pub queue_full: u64,
    /// Of those delivered, latched messages that were sent again for others, and are known here.
    pub repeats: u64,
    /// Writers that offer the newest message, where this subscription asks for every: ROS calls
    /// that incompatible QoS. Their newest are delivered.
    pub incompatible_writers: usize,
    /// Segments and messages that were dropped on arrival, by reason ([`DropReason::label`]).
    /// Reasons without a drop are left out.
    pub drops: BTreeMap<&'static str, u64>,
}

/// A counter that only rises.
#[derive(Default)]
pub struct Count(AtomicU64);

impl Count {
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// Takes over what is counted elsewhere.
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
    /// Frames refused before their payload was looked at, by [`Counter`].
    pub refused: [Count; Counter::COUNT],
    /// Frames for a name nobody here subscribed to.
    pub not_subscribed: Count,
    /// Messages the application did not take in time.
    pub queue_full: Count,
    /// Requests to what is not served here, or of those who may not call it.
    pub requests_refused: Count,
    /// Frames of reliable names that there was no room for; they come again.
    pub beyond: Count,
    /// Told to counterparts, and what they told.
    pub feedback_sent: Count,
    pub feedback_received: Count,
    /// Frames to this node's own name: from none of its counterparts; not sealed by it; received
    /// before, as by another of two links; of no sense.
    pub feedback_unknown: Count,
    pub feedback_forged: Count,
    pub feedback_replayed: Count,
    pub feedback_malformed: Count,
    /// Segments and messages a reader dropped, by [`DropReason`].
    pub dropped: [Count; DropReason::COUNT],
}

/// The counters of a node at one moment.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct NodeCounters {
    pub messages_sent: u64,
    /// Refused at once: no link, or no right. What became of the others
    /// [`Publisher::counters`](super::Publisher::counters) say.
    pub messages_unsent: u64,
    pub messages_received: u64,
    pub frames_sent: u64,
    pub frames_unsent: u64,
    /// Frames from the switch, before any check.
    pub frames_received: u64,
    /// Links made so far; all but the first are reconnections.
    pub links: u64,
    /// Errors from the switch about frames of this node, by what they say. Those that did not come
    /// are left out.
    pub errors_received: BTreeMap<&'static str, u64>,
    /// Echoes of the switch that were answered.
    pub echoes_answered: u64,
    /// What was told to readers and writers, and what they told: frames besides those of messages.
    pub feedback_sent: u64,
    pub feedback_received: u64,
    /// Frames, segments and messages that were dropped on arrival, by reason. Reasons without a
    /// drop are left out.
    pub drops: BTreeMap<&'static str, u64>,
}

impl Counters {
    /// `socket_drops`: what the kernel dropped before this process saw it.
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

/// Those that are not 0, by the name of the code.
pub fn by_code(counts: &[Count; ErrorCode::COUNT]) -> BTreeMap<&'static str, u64> {
    let counts = ErrorCode::ALL.iter().zip(counts).map(|(code, count)| (code.as_str(), count.get()));
    counts.filter(|(_, count)| *count > 0).collect()
}
