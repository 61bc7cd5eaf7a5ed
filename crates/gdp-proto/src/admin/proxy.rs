//! The proxy as it sees itself: `gdp-ctl status` where only a proxy runs, and `--stats`.

use std::fmt;

use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::links::Counts;
use super::words::{FabricLinkState, TopicDirection};

/// What a proxy carries and counts: the same object as its statistics file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProxyReply {
    /// The version of this format. It changes whenever a key is removed or changes its meaning.
    pub version: u32,
    /// The proxy's own name.
    pub entity: Name,
    /// The switch at the other end of the main link; null while the link is lost.
    pub switch: Option<Name>,
    /// When the proxy's membership in its domain ends, in Unix seconds; null without a valid one.
    pub member_until: Option<u64>,
    /// Why the membership is not valid; null if it is, or without a domain.
    pub member_error: Option<String>,
    pub topics: Vec<ProxyTopic>,
    /// The catalogs, which carry automatically matched topics and calls.
    pub catalogs: Vec<ProxyCatalog>,
    /// The directory of the domain; null unless this proxy follows one.
    pub directory: Option<ProxyDirectory>,
    /// Services and actions.
    pub calls: Vec<ProxyCall>,
    /// The links, in the order of the configuration.
    pub links: Vec<ProxyLink>,
    /// The counterparts whose clocks differ, so that messages are refused as too old.
    #[serde(default)]
    pub clocks: Vec<ProxyClock>,
    /// The counters of the proxy's node in the fabric.
    pub node: ProxyNode,
}

/// A counterpart whose clock differs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProxyClock {
    pub peer: Name,
    /// Milliseconds by which the peer's clock is ahead of this one; negative if it is behind.
    pub ahead_ms: i64,
    /// The peer refuses messages of this proxy. Otherwise this proxy refuses those of the peer.
    pub refuses: bool,
}

impl fmt::Display for ProxyClock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { peer, ahead_ms, refuses } = self;
        let direction = if *ahead_ms < 0 { "behind" } else { "ahead of" };
        let what = if *refuses { "it refuses" } else { "this machine refuses its" };
        let seconds = ahead_ms.unsigned_abs() / 1000;
        write!(f, "the clock of {peer:#} is {seconds} s {direction} the one here, and {what} messages as too old")
    }
}

/// One topic in one direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProxyTopic {
    pub topic: String,
    /// The ROS graph's name in the configuration.
    pub graph: String,
    /// The ROS type, as that graph writes it; null while it is unknown.
    #[serde(rename = "type")]
    pub kind: Option<String>,
    /// `up`, or the reason why not.
    pub status: String,
    /// What is missing for messages to flow; null if nothing is.
    pub waiting_for: Option<String>,
    /// When the certificate ends, in Unix seconds; null if that is not known.
    pub certificate_until: Option<u64>,
    pub direction: TopicDirection,
    pub name: Name,
    pub messages: u64,
    /// Those among them that were carried by the receiving thread, without the route's task.
    pub direct: u64,
    /// Bytes of the carried messages. `out`: as converted; `in`: as written.
    pub bytes: u64,
    /// Bytes of the same messages as they travel: fewer if they are compressed.
    pub bytes_carried: u64,
    /// Dropped messages by reason, with zero for reasons that did not occur.
    pub drops: Counts,
    pub latency_us: TopicLatency,
    /// Counters of the fabric; null before the route is up for the first time.
    pub fabric: Option<FabricTopic>,
}

/// Latency of each stage in microseconds; null before the first message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TopicLatency {
    /// Age of messages when the proxy has them. `out`: since the ROS node wrote them; `in`: since
    /// the other proxy sealed them, by the clocks of two machines.
    pub arrival: Option<StagePercentiles>,
    /// Time to process a message.
    pub handling: Option<StagePercentiles>,
}

/// Percentiles in microseconds of the latest messages.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StagePercentiles {
    pub p50: u32,
    pub p99: u32,
}

/// The fabric's counters of a topic on this side.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum FabricTopic {
    Out(PublishedCounts),
    In(SubscribedCounts),
}

/// What became of messages that this side publishes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PublishedCounts {
    pub messages: u64,
    /// Messages that newer ones replaced before all their frames were sent.
    pub replaced: u64,
    /// Messages whose lifetime ended before all their frames were sent.
    pub expired: u64,
    /// Messages that left the history of a reliable topic before every live reader had them.
    pub evicted: u64,
    /// Frame payloads sent, including repairs.
    pub frames: u64,
    pub repeated: u64,
    /// Frames that a reader requested beyond its budget.
    pub over_budget: u64,
    /// Frames that readers received with a congestion mark.
    pub marked: u64,
    /// Number of times that a path became congested and its rate was reduced.
    pub slowed: u64,
    /// Attached readers.
    pub readers: usize,
    /// Attached readers that request every message from a best-effort publisher.
    pub incompatible_readers: usize,
    /// Error reports of the switch about refused frames.
    pub refused: Counts,
}

/// What became of messages that this side reads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SubscribedCounts {
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
    /// Delivered messages that the application did not receive in time.
    pub queue_full: u64,
    /// Delivered latched messages that this reader already had.
    pub repeats: u64,
    /// Best-effort writers in a subscription that requests every message.
    pub incompatible_writers: usize,
    /// Segments and messages dropped on arrival, by reason.
    pub drops: Counts,
}

impl ProxyTopic {
    /// Returns the messages that were lost or dropped on the way, at this proxy or in the fabric
    /// before it.
    pub fn lost(&self) -> u64 {
        let fabric = match &self.fabric {
            None => 0,
            Some(FabricTopic::Out(of)) => of.replaced + of.expired + of.evicted,
            Some(FabricTopic::In(of)) => of.overtaken + of.expired + of.abandoned + of.queue_full,
        };
        // A rate limit and messages of this proxy itself are no loss.
        let is_loss = |reason: &str| !["max_hz", "own"].contains(&reason);
        fabric + self.drops.iter().filter(|(reason, _)| is_loss(reason)).map(|(_, count)| count).sum::<u64>()
    }

    /// Returns the number of attached readers of a topic that this side publishes.
    pub fn readers(&self) -> Option<usize> {
        match &self.fabric {
            Some(FabricTopic::Out(of)) => Some(of.readers),
            _ => None,
        }
    }
}

/// One catalog.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProxyCatalog {
    pub name: Name,
    pub direction: TopicDirection,
    /// `up`, or what the catalog waits for.
    pub status: String,
}

/// The domain's directory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProxyDirectory {
    pub name: Name,
    /// `up`, or the reason why not.
    pub status: String,
    pub waiting_for: Option<String>,
}

/// One service or action in one direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProxyCall {
    /// `service` or `action`.
    pub what: String,
    pub service: String,
    /// The ROS graph's name in the configuration.
    pub graph: String,
    /// The ROS type, as that graph writes it; null while it is unknown.
    #[serde(rename = "type")]
    pub kind: Option<String>,
    /// `up`, or the reason why not.
    pub status: String,
    /// What is missing for calls to pass; null if nothing is.
    pub waiting_for: Option<String>,
    /// When the certificate ends, in Unix seconds; null if that is not known.
    pub certificate_until: Option<u64>,
    pub direction: TopicDirection,
    pub name: Name,
    pub calls: u64,
    pub answers: u64,
    /// Failed calls by reason, with zero for reasons that did not occur.
    pub failures: Counts,
    /// Calls that are pending at this moment.
    pub pending: u64,
    /// Servers that can be called at this moment.
    pub servers: u64,
    /// Calls that went to several servers at once.
    pub calls_replicated: u64,
    /// Calls whose answer was no longer needed.
    pub copies_cancelled: u64,
    /// Replicated calls that another server than the nearest answered first.
    pub answers_by_other: u64,
    /// Feedback and status messages of actions that were carried.
    pub events: u64,
    /// Feedback messages that found no room or came too late.
    pub events_dropped: u64,
}

/// One link of the proxy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProxyLink {
    pub target: String,
    pub state: FabricLinkState,
    /// Why the link is not up.
    pub reason: Option<String>,
    /// Whether this is the main link.
    pub main: bool,
    /// The current or last switch at the other end; null if the link is down.
    pub switch: Option<Name>,
    pub frames_sent: u64,
    pub frames_unsent: u64,
    /// Copies among the frames sent, which the main link carried as well.
    pub copies_sent: u64,
    pub copies_dropped: u64,
}

/// Counters of the proxy's node in the fabric.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProxyNode {
    pub messages_sent: u64,
    /// Messages refused immediately, without a link or without a right.
    pub messages_unsent: u64,
    pub messages_received: u64,
    pub frames_sent: u64,
    pub frames_unsent: u64,
    /// Frames from the switch, before validation.
    pub frames_received: u64,
    /// Links made so far.
    pub links: u64,
    /// Errors from the switch about frames of this node, by error code.
    pub errors_received: Counts,
    /// Echoes from the switch that this node answered.
    pub echoes_answered: u64,
    pub feedback_sent: u64,
    pub feedback_received: u64,
    /// Frames, segments and messages dropped on arrival, by reason.
    pub drops: Counts,
}
