//! What it costs to cross a link, as its round-trip time says: steady, because every change may
//! move traffic to another path.

use std::collections::VecDeque;
use std::time::Duration;

/// A hop costs this much besides what its round-trip time adds: as much as 2 ms do. So the
/// differences between cables on one site, which are mostly those of how busy the daemons are,
/// choose no path.
pub const HOP: u32 = 200;

/// A link costs this much at most: that of 1 s.
pub const MOST: u32 = HOP + 100_000;

/// What adds 1 to the cost.
const STEP: Duration = Duration::from_micros(10);

/// The shortest time of so long counts: what radio links add now and then is no property of the
/// path.
const WINDOW: Duration = Duration::from_secs(30);

/// Another cost is stated once it has differed by more than a quarter for so long.
const STEADY: Duration = Duration::from_secs(5);

/// The measured cost of the link to one neighbour.
#[derive(Debug)]
pub struct Meter {
    cost: u32,
    /// When, and what it would have cost then; in both rising from the first to the last.
    recent: VecDeque<(Duration, u32)>,
    differs_since: Option<Duration>,
    /// Nothing but the link's handshake has been measured.
    is_first: bool,
}

impl Meter {
    /// Of a link that has just been made, with the round-trip time that showed; or of one that a
    /// daemon before this one made, of which nothing is known: it costs what a hop does, and what
    /// its other end has measured counts.
    pub fn new(now: Duration, rtt: Option<Duration>) -> Self {
        let recent = rtt.map(|rtt| (now, cost_of(rtt))).into_iter().collect();
        Self { cost: rtt.map_or(HOP, cost_of), recent, differs_since: None, is_first: rtt.is_some() }
    }

    /// The first request over a new link was answered within this time. The handshake took longer
    /// than what follows it, because both sides computed; so this counts at once. Whether the link
    /// costs something else from now on.
    pub fn answered(&mut self, now: Duration, rtt: Duration) -> bool {
        let cost = cost_of(rtt);
        if !std::mem::take(&mut self.is_first) || cost >= self.cost {
            return false;
        }
        (self.cost, self.recent) = (cost, VecDeque::from([(now, cost)]));
        true
    }

    /// What crossing the link costs.
    pub fn cost(&self) -> u32 {
        self.cost
    }

    /// Takes one more sample of the link's round-trip time; whether the link costs something else
    /// from now on.
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
