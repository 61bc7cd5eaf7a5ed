//! The counterparts whose clocks differ from this one by more than messages may be old. They state
//! their time in authenticated feedback. What they state is shown and never sets a clock.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use gdp_util::line_limit::LineLimit;
use gdp_wire::Name;
use parking_lot::Mutex;

/// The difference from which on it counts.
const LEAST: Duration = Duration::from_secs(5);

/// Time for which a difference is shown, and the minimum time between two lines about a peer.
/// Readers ask again three times in it while messages are refused.
const PERIOD: Duration = Duration::from_secs(60);

/// Maximum number of peers. The oldest make room.
const MAX_PEERS: usize = 128;

/// The limit on lines about all peers.
static LINES: LineLimit = LineLimit::new(20, PERIOD);

/// A counterpart whose clock differs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct ClockDifference {
    pub peer: Name,
    /// Milliseconds by which the peer's clock is ahead of this one; negative if it is behind.
    pub ahead_ms: i64,
    /// The peer refuses messages of this node. Otherwise this node refuses those of the peer.
    pub refuses: bool,
}

#[derive(Default)]
pub struct ClockDifferences(Mutex<BTreeMap<Name, StatedClock>>);

struct StatedClock {
    difference: ClockDifference,
    at: Instant,
    logged: Option<Instant>,
}

impl ClockDifferences {
    /// Records by how many nanoseconds the clock of a peer is ahead, and logs it if that is new.
    /// `refuses` is that of [`ClockDifference`]. Messages are too old only for a clock that is
    /// ahead of the writer's.
    pub fn record(&self, now: Instant, peer: Name, ahead_ns: i64, refuses: bool) {
        let difference = ClockDifference { peer, ahead_ms: ahead_ns / 1_000_000, refuses };
        let mut peers = self.0.lock();
        let is_cause = refuses == (ahead_ns > 0);
        if Duration::from_nanos(ahead_ns.unsigned_abs()) < LEAST || !is_cause {
            // What was too old was late, or is an old message again.
            peers.remove(&peer);
            return;
        }
        if peers.len() >= MAX_PEERS && !peers.contains_key(&peer) {
            let oldest = peers.iter().min_by_key(|(_, entry)| entry.at).map(|(peer, _)| *peer);
            oldest.and_then(|oldest| peers.remove(&oldest));
        }
        let entry = peers.entry(peer).or_insert(StatedClock { difference, at: now, logged: None });
        (entry.difference, entry.at) = (difference, now);
        if entry.logged.is_some_and(|at| now.saturating_duration_since(at) < PERIOD) {
            return;
        }
        entry.logged = Some(now);
        if LINES.take(now).is_some() {
            tracing::warn!(peer = %format_args!("{peer:#}"), "{difference}");
        }
    }

    /// Returns the differences of the last minute, by peer.
    pub fn all(&self, now: Instant) -> Vec<ClockDifference> {
        let mut peers = self.0.lock();
        peers.retain(|_, entry| now.saturating_duration_since(entry.at) < PERIOD);
        peers.values().map(|entry| entry.difference).collect()
    }
}

impl std::fmt::Display for ClockDifference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { peer, ahead_ms, refuses } = self;
        let seconds = ahead_ms.unsigned_abs() / 1000;
        let direction = if *ahead_ms < 0 { "behind" } else { "ahead of" };
        match refuses {
            true => write!(f, "{peer:#} refuses the messages of this machine as too old: ")?,
            false => write!(f, "messages of {peer:#} are refused as too old: ")?,
        }
        write!(f, "its clock is {seconds} s {direction} the one here; set the wrong one (`timedatectl` shows it)")
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/clock_differences.rs"]
mod tests;
