//! Link cost from the measured round-trip time. It is kept steady, because every change may move
//! traffic to another path.

use std::collections::VecDeque;
use std::time::Duration;

/// Base cost of a hop, equal to 2 ms of round-trip time. Differences between the links of one site
/// thus do not decide a path: they mostly reflect how busy the daemons are.
pub const HOP: u32 = 200;

/// Maximum cost of a link, equal to 1 s of round-trip time.
pub const MOST: u32 = HOP + 100_000;

/// Cost of a link that should carry frames only where no other path exists: it does not answer, or
/// is suppressed (compare MaxLinkMetric, RFC 6987). Above that of any path of measured links.
pub const AVOIDED: u32 = u32::MAX;

/// Round-trip time that adds 1 to the cost.
const STEP: Duration = Duration::from_micros(10);

/// Window of the minimum filter. The smallest sample counts, because occasional delays of radio
/// links are no property of the path.
const WINDOW: Duration = Duration::from_secs(30);

/// Time for which the cost must differ by more than a quarter before a new one is stated.
const STEADY: Duration = Duration::from_secs(5);

/// Measured cost of the link to one neighbour.
#[derive(Debug)]
pub struct Meter {
    cost: u32,
    /// Samples (time, cost), both increasing from front to back.
    recent: VecDeque<(Duration, u32)>,
    differs_since: Option<Duration>,
    /// Only the link's handshake has been measured.
    is_first: bool,
}

impl Meter {
    /// Creates the meter of a new link from the round-trip time of its handshake.
    ///
    /// `None` stands for a link that an earlier daemon made and of which nothing is known. It costs
    /// one hop until measured, so the other end's measurement counts.
    pub fn new(now: Duration, rtt: Option<Duration>) -> Self {
        let recent = rtt.map(|rtt| (now, cost_of(rtt))).into_iter().collect();
        Self { cost: rtt.map_or(HOP, cost_of), recent, differs_since: None, is_first: rtt.is_some() }
    }

    /// Processes the round-trip time of the first request over a new link. Returns whether the cost
    /// has changed.
    ///
    /// The handshake took longer, because both sides computed. A lower time therefore counts at
    /// once.
    pub fn answered(&mut self, now: Duration, rtt: Duration) -> bool {
        let cost = cost_of(rtt);
        if !std::mem::take(&mut self.is_first) || cost >= self.cost {
            return false;
        }
        (self.cost, self.recent) = (cost, VecDeque::from([(now, cost)]));
        true
    }

    /// Returns the cost of the link.
    pub fn cost(&self) -> u32 {
        self.cost
    }

    /// Adds a sample of the round-trip time. Returns whether the cost has changed.
    pub fn sample(&mut self, now: Duration, rtt: Duration) -> bool {
        let cost = cost_of(rtt);
        while self.recent.back().is_some_and(|(_, larger)| *larger >= cost) {
            self.recent.pop_back();
        }
        self.recent.push_back((now, cost));
        while self.recent.front().is_some_and(|(at, _)| *at + WINDOW <= now) {
            self.recent.pop_front();
        }
        let shortest = self.recent.front().map_or(cost, |(_, cost)| *cost);
        if u64::from(shortest.abs_diff(self.cost)) * 4 <= u64::from(self.cost) {
            self.differs_since = None;
            return false;
        }
        if now - *self.differs_since.get_or_insert(now) < STEADY {
            return false;
        }
        (self.cost, self.differs_since) = (shortest, None);
        true
    }
}

fn cost_of(rtt: Duration) -> u32 {
    let steps = rtt.as_nanos() / STEP.as_nanos();
    u32::try_from(steps).unwrap_or(MOST).saturating_add(HOP).min(MOST)
}

#[cfg(test)]
#[path = "../../tests/unit/topology/cost.rs"]
mod tests;
