//! Counters: what crossed, and what did not and why. Counting never allocates or locks;
//! [`StatsFile`] shows the counters to other programs.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use gdp::{LinkStatus, Meter, NodeCounters, PublisherCounters, SubscriptionCounters};
use gdp_util::escape::escape_json;
use gdp_wire::Name;
use serde::Serialize;

use crate::automatic::CatalogStats;
use crate::call::CallStats;
use crate::config::Side;
use crate::tally::{Tally, reasons};
use crate::timing::{Percentiles, Timing};

reasons! {
    /// Why a message did not cross. What the fabric drops is in [`FabricCounters`].
    pub enum Drop {
        /// A local message is not XCDR version 1.
        Unreadable = "unreadable",
        /// A local message was lost between its writer and the proxy: what best effort drops, and
        /// what came too fast.
        Lost = "lost",
        /// The fabric did not take the message.
        SendFailed = "send_failed",
        /// A local message came sooner than the configuration wants them.
        MaxHz = "max_hz",
        /// A message is not of its type, or not of one that this proxy can convert.
        Unconvertible = "unconvertible",
        /// A remote message's publisher has no counterpart here; the status says why.
        NoCounterpart = "no_counterpart",
        /// Remote messages of a writer that has not said of what they are.
        Unannounced = "unannounced",
        /// Remote messages that are not kept for late subscribers, or did not wait for the first:
        /// there are too many bytes of them.
        Crowded = "crowded",
        /// A remote message, or what its writer says of the topic, is not what a proxy sends.
        Malformed = "malformed",
        /// A remote message is one that this proxy sent, or another in the same ROS graph.
        Own = "own",
        /// The sockets of this host do not take messages as fast as they come.
        Stalled = "stalled",
        /// DDS did not take the message.
        WriteFailed = "write_failed",
    }
}

/// What one topic did in one direction.
#[derive(Default)]
pub struct RouteCounters {
    messages: AtomicU64,
    bytes: AtomicU64,
    bytes_carried: AtomicU64,
    drops: Tally<Drop>,
    /// Until the proxy has a message: `out` since the ROS node wrote it, `in` since the other proxy
    /// sealed it.
    pub arrival: Timing,
    /// `out`: to seal, sign and send it; `in`: to write it into DDS.
    pub handling: Timing,
}

impl RouteCounters {
    /// One message crossed; `bytes` with its encapsulation, and of these so many travel.
    pub fn passed(&self, bytes: usize, carried: usize) {
        self.messages.fetch_add(1, Relaxed);
        self.bytes.fetch_add(bytes as u64, Relaxed);
        self.bytes_carried.fetch_add(carried as u64, Relaxed);
    }

    /// So many did not. True if they are the first ones for this reason, which deserves a line in
    /// the log.
    pub fn dropped(&self, reason: Drop, count: u64) -> bool {
        self.drops.add(reason, count)
    }

    pub fn read(&self) -> Counted {
        Counted {
            messages: self.messages.load(Relaxed),
            bytes: self.bytes.load(Relaxed),
            bytes_carried: self.bytes_carried.load(Relaxed),
            drops: self.drops.read(),
            latency_us: StageLatency { arrival: self.arrival.percentiles(), handling: self.handling.percentiles() },
        }
    }
}

/// What the fabric does with the topic's messages on this side, since the route came up last.
#[derive(Clone)]
pub enum FabricCounters {
    None,
    Out(Meter<PublisherCounters>),
    In(Meter<SubscriptionCounters>),
}

/// The same at one moment.
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

/// One topic, as the statistics file shows it.
#[derive(Serialize)]
pub struct RouteStats {
    pub topic: String,
    /// The ROS graph, as the configuration calls it.
    pub graph: String,
    /// ROS type, as that graph calls it; null while it is not known.
    #[serde(rename = "type")]
    pub kind: Option<String>,
    /// `up`, or what the route waits for.
    pub status: String,
    pub direction: Side,
    pub name: Name,
    #[serde(flatten)]
    pub counted: Counted,
    /// `gdp::PublisherCounters` of what goes `out`, `SubscriptionCounters` of what comes
    /// `in`, with what was dropped by reason; null before the first time that the route is up.
    pub fabric: FabricStats,
}

/// What the counters of a route say at one moment.
#[derive(Default, Serialize)]
pub struct Counted {
    pub messages: u64,
    /// `out`: as they were converted; `in`: as they are written.
    pub bytes: u64,
    /// Of the same messages, as they travel: fewer where they are compressed.
    pub bytes_carried: u64,
    /// All reasons, also those that did not happen.
    pub drops: BTreeMap<&'static str, u64>,
    pub latency_us: StageLatency,
}

/// Where the time goes, in microseconds; null before the first message.
#[derive(Default, Serialize)]
pub struct StageLatency {
    /// See [`RouteCounters::arrival`]. By the clocks of both machines, so as true as they agree.
    pub arrival: Option<Percentiles>,
    /// See [`RouteCounters::handling`].
    pub handling: Option<Percentiles>,
}

/// Of the statistics file's format: another one whenever a key goes, or means something else.
pub const VERSION: u32 = 4;

/// The whole statistics file: one JSON object.
#[derive(Serialize)]
pub struct Stats {
    /// Of this format: [`VERSION`].
    pub version: u32,
    /// The proxy's own name.
    pub entity: Name,
    /// Where it is attached by its main link; null while the link is lost.
    pub switch: Option<Name>,
    pub topics: Vec<RouteStats>,
    /// Of what crosses by itself.
    pub catalogs: Vec<CatalogStats>,
    /// Services and actions.
    pub calls: Vec<CallStats>,
    /// In the order of the configuration.
    pub links: Vec<LinkStatus>,
    /// The fabric's side of it.
    pub node: NodeCounters,
}

/// A file that always holds one whole object: it is replaced, never written to.
pub struct StatsFile(PathBuf);

impl StatsFile {
    pub fn new(path: PathBuf) -> Self {
        Self(path)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Whether the file can be made at all: a mistaken path is better said before anything depends
    /// on the proxy.
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
