//! Counters of carried and dropped messages. Counting never allocates or locks. [`StatsFile`] shows
//! the counters to other programs.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use gdp::unstable::{ClockDifference, LinkStatus, Meter, NodeCounters, PublisherCounters, SubscriptionCounters};
use gdp_util::escape::escape_json;
use gdp_wire::Name;
use serde::Serialize;

use crate::automatic::CatalogStats;
use crate::call::CallStats;
use crate::config::Side;
use crate::tally::{Tally, reasons};
use crate::timing::{Percentiles, Timing};
use crate::waiting::Waiting;

reasons! {
    /// Reasons for which the proxy drops a message. [`FabricCounters`] counts the drops of the
    /// fabric.
    pub enum Drop {
        /// A local message is not encoded in XCDR version 1.
        Unreadable = "unreadable",
        /// A local message was lost between its writer and the proxy: by best-effort delivery, or
        /// because messages came too fast.
        Lost = "lost",
        /// The fabric refused the message.
        SendFailed = "send_failed",
        /// A newer local message replaced it before its turn under the configured maximum rate.
        MaxHz = "max_hz",
        /// A message does not match its type, or the proxy cannot convert its type.
        Unconvertible = "unconvertible",
        /// The publisher of a remote message has no counterpart in this graph. The status gives the
        /// reason.
        NoCounterpart = "no_counterpart",
        /// The writer of a remote message has not announced what it publishes.
        Unannounced = "unannounced",
        /// The proxy has no room to store a remote message for late subscribers or until the first
        /// subscriber: too many bytes are stored.
        Crowded = "crowded",
        /// A remote message, or its writer's announcement of the topic, is not in the format of a
        /// proxy.
        Malformed = "malformed",
        /// A remote message comes from this proxy, or from another proxy in the same ROS graph.
        Own = "own",
        /// The sockets of this host do not accept messages as fast as they arrive.
        Stalled = "stalled",
        /// DDS refused the message.
        WriteFailed = "write_failed",
    }
}

/// Counters of one topic in one direction.
#[derive(Default)]
pub struct RouteCounters {
    messages: AtomicU64,
    direct: AtomicU64,
    bytes: AtomicU64,
    bytes_carried: AtomicU64,
    drops: Tally<Drop>,
    /// Time until the proxy has a message. `out`: since the ROS node wrote it; `in`: since the
    /// other proxy sealed it.
    pub arrival: Timing,
    /// Time to process a message. `out`: to seal, sign and send it; `in`: to write it into DDS.
    pub handling: Timing,
}

impl RouteCounters {
    /// Counts one carried message: `bytes` with its encapsulation, `carried` as it travels.
    pub fn passed(&self, bytes: usize, carried: usize) {
        self.messages.fetch_add(1, Relaxed);
        self.bytes.fetch_add(bytes as u64, Relaxed);
        self.bytes_carried.fetch_add(carried as u64, Relaxed);
    }

    /// Counts one message that was carried unchanged, without the route's task.
    pub fn passed_directly(&self, bytes: usize) {
        self.direct.fetch_add(1, Relaxed);
        self.passed(bytes, bytes);
    }

    /// Counts `count` dropped messages. Returns true if they are the first for this reason, which
    /// deserves a line in the log.
    pub fn dropped(&self, reason: Drop, count: u64) -> bool {
        self.drops.add(reason, count)
    }

    pub fn read(&self) -> Counted {
        Counted {
            messages: self.messages.load(Relaxed),
            direct: self.direct.load(Relaxed),
            bytes: self.bytes.load(Relaxed),
            bytes_carried: self.bytes_carried.load(Relaxed),
            drops: self.drops.read(),
            latency_us: StageLatency { arrival: self.arrival.percentiles(), handling: self.handling.percentiles() },
        }
    }
}

/// The fabric's counters of the topic's messages on this side, since the route was last
/// established.
#[derive(Clone)]
pub enum FabricCounters {
    None,
    Out(Meter<PublisherCounters>),
    In(Meter<SubscriptionCounters>),
}

/// The values of [`FabricCounters`] at one moment.
#[derive(Default, Serialize)]
#[serde(untagged)]
pub enum FabricStats {
    #[default]
    None,
    Out(PublisherCounters),
    In(SubscriptionCounters),
}

impl FabricCounters {
    pub fn read(&self) -> FabricStats {
        match self {
            Self::None => FabricStats::None,
            Self::Out(of) => FabricStats::Out(of.read()),
            Self::In(of) => FabricStats::In(of.read()),
        }
    }
}

/// The statistics of one topic in one direction, as the statistics file shows them.
#[derive(Serialize)]
pub struct RouteStats {
    pub topic: String,
    /// The ROS graph's name in the configuration.
    pub graph: String,
    /// The ROS type, as that graph writes it; null while it is unknown.
    #[serde(rename = "type")]
    pub kind: Option<String>,
    /// `up`, or the reason why not.
    pub status: String,
    /// What is missing for messages to flow; null if nothing is.
    pub waiting_for: Option<Waiting>,
    /// When the certificate ends, in Unix seconds; null if that is not known.
    pub certificate_until: Option<u64>,
    pub direction: Side,
    pub name: Name,
    #[serde(flatten)]
    pub counted: Counted,
    /// `PublisherCounters` for `out`, `SubscriptionCounters` for `in`, with the drops by
    /// reason. Null before the route is up for the first time.
    pub fabric: FabricStats,
}

/// The state of the domain's directory.
#[derive(Serialize)]
pub struct DirectoryStats {
    pub name: Name,
    /// `up`, or the reason why not.
    pub status: String,
    pub waiting_for: Option<Waiting>,
}

/// The values of a route's counters at one moment.
#[derive(Default, Serialize)]
pub struct Counted {
    pub messages: u64,
    /// Those among them that were carried by the receiving thread, without the route's task.
    pub direct: u64,
    /// Bytes of the carried messages. `out`: as converted; `in`: as written.
    pub bytes: u64,
    /// Bytes of the same messages as they travel: fewer if they are compressed.
    pub bytes_carried: u64,
    /// Dropped messages by reason, with zero for reasons that did not occur.
    pub drops: BTreeMap<&'static str, u64>,
    pub latency_us: StageLatency,
}

/// Latency of each stage in microseconds; null before the first message.
#[derive(Default, Serialize)]
pub struct StageLatency {
    /// See [`RouteCounters::arrival`]. It compares the clocks of two machines, and is as accurate
    /// as they agree.
    pub arrival: Option<Percentiles>,
    /// See [`RouteCounters::handling`].
    pub handling: Option<Percentiles>,
}

/// Version of the statistics file's format. It changes whenever a key is removed or changes its
/// meaning.
pub const VERSION: u32 = 5;

/// The whole statistics file: one JSON object.
#[derive(Serialize)]
pub struct Stats {
    /// The version of this format: [`VERSION`].
    pub version: u32,
    /// The proxy's own name.
    pub entity: Name,
    /// The switch at the other end of the main link; null while the link is lost.
    pub switch: Option<Name>,
    /// When the proxy's membership in its domain ends, in Unix seconds; null without a valid one.
    pub member_until: Option<u64>,
    /// Why the membership is not valid; null if it is, or without a domain.
    pub member_error: Option<String>,
    pub topics: Vec<RouteStats>,
    /// The catalogs, which carry automatically matched topics and calls.
    pub catalogs: Vec<CatalogStats>,
    /// The directory of the domain; null unless this proxy follows one.
    pub directory: Option<DirectoryStats>,
    /// Services and actions.
    pub calls: Vec<CallStats>,
    /// The links, in the order of the configuration.
    pub links: Vec<LinkStatus>,
    /// The counterparts whose clocks differ, so that messages are refused as too old.
    pub clocks: Vec<ClockDifference>,
    /// The counters of the proxy's node in the fabric.
    pub node: NodeCounters,
}

/// A file that always holds one whole JSON object. The proxy replaces it and never writes to it in
/// place.
pub struct StatsFile(PathBuf);

impl StatsFile {
    pub fn new(path: PathBuf) -> Self {
        Self(path)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Checks that the file can be created, so that a wrong path is reported before anything
    /// depends on the proxy.
    pub fn probe(&self) -> io::Result<()> {
        std::fs::File::create(self.next())?;
        std::fs::remove_file(self.next())
    }

    pub fn replace(&self, stats: &Stats) -> io::Result<()> {
        let mut text = escape_json(&serde_json::to_string(stats)?).into_owned();
        text.push('\n');
        std::fs::File::create(self.next())?.write_all(text.as_bytes())?;
        std::fs::rename(self.next(), &self.0)
    }

    fn next(&self) -> PathBuf {
        let mut next = self.0.clone().into_os_string();
        next.push(".new");
        next.into()
    }
}

#[cfg(test)]
#[path = "../tests/unit/stats.rs"]
mod tests;
