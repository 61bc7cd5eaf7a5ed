//! Selects the publishers of a topic to connect to, without I/O. It knows the master's list, the
//! state of each connection, and the time of the next attempt.
//!
//! What the master lists is not believed in one case. A master that was started anew knows only who
//! has registered since, and most ROS 1 nodes never register twice: their connections are fine all
//! the same. So only a master that has listed a publisher itself can end the connection to it by
//! not listing it any more. One that it never listed keeps its connection as long as that lives.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::time::{Duration, Instant};

use gdp_util::backoff::Backoff;

/// Before a publisher is connected to again.
const RETRY: Backoff = Backoff::new(Duration::from_millis(200), Duration::from_secs(10));

/// Publishers of one topic.
pub const MAX_SOURCES: usize = 1024;

/// A connection that held so long was a good one: the next attempt is made soon.
const STABLE_AFTER: Duration = Duration::from_secs(5);

/// The publishers of one topic, by the URIs of their slave APIs.
pub struct Sources {
    own: String,
    known: BTreeMap<String, PublisherSource>,
}

struct PublisherSource {
    /// The last run of the master in which it was listed.
    listed: u64,
    /// Whether it still is.
    wanted: bool,
    state: SourceState,
    backoff: Backoff,
}

enum SourceState {
    Waiting { until: Instant },
    Connecting,
    Connected { since: Instant },
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceAction {
    /// Connect; when that has ended, [`Sources::ended`] is to be called.
    Connect(String),
    /// Forget it, and end the connection if there is one. No more is heard of it.
    Drop(String),
}

impl Sources {
    /// `own`: this node's slave API, which is never connected to.
    pub fn new(own: String) -> Self {
        Self { own, known: BTreeMap::new() }
    }

    /// The master lists these, in its run of this number.
    pub fn listed(&mut self, run: u64, publishers: &[String], now: Instant) -> Vec<SourceAction> {
        for source in self.known.values_mut() {
            source.wanted = false;
        }
        for publisher in publishers {
            if *publisher == self.own {
                continue;
            }
            let room = self.known.len() < MAX_SOURCES;
            match self.known.entry(publisher.clone()) {
                Entry::Occupied(mut known) => (known.get_mut().listed, known.get_mut().wanted) = (run, true),
                Entry::Vacant(new) if room => {
                    let state = SourceState::Waiting { until: now };
                    new.insert(PublisherSource { listed: run, wanted: true, state, backoff: RETRY });
                }
                Entry::Vacant(_) => {
                    tracing::warn!(publisher, MAX_SOURCES, "a topic has more publishers than are connected to");
                }
            }
        }
        let mut dropped = Vec::new();
        self.known.retain(|publisher, source| {
            let kept = match source.state {
                SourceState::Waiting { .. } => source.wanted,
                SourceState::Connecting | SourceState::Connected { .. } => source.wanted || source.listed != run,
            };
            if !kept {
                dropped.push(SourceAction::Drop(publisher.clone()));
            }
            kept
        });
        dropped.extend(self.due(now));
        dropped
    }

    /// Whom to connect to now.
    pub fn due(&mut self, now: Instant) -> Vec<SourceAction> {
        let mut actions = Vec::new();
        for (publisher, source) in &mut self.known {
            if matches!(source.state, SourceState::Waiting { until } if until <= now) {
                source.state = SourceState::Connecting;
                actions.push(SourceAction::Connect(publisher.clone()));
            }
        }
        actions
    }

    /// When somebody is to be connected to, if nothing happens before.
    pub fn next_due(&self) -> Option<Instant> {
        let waiting = |source: &PublisherSource| match source.state {
            SourceState::Waiting { until } => Some(until),
            SourceState::Connecting | SourceState::Connected { .. } => None,
        };
        self.known.values().filter_map(waiting).min()
    }

    /// A connection is made.
    pub fn connected(&mut self, publisher: &str, now: Instant) {
        if let Some(source) = self.known.get_mut(publisher) {
            source.state = SourceState::Connected { since: now };
        }
    }

    /// A connection has ended, or was never made. Returns whether it will be tried again.
    pub fn ended(&mut self, publisher: &str, now: Instant) -> bool {
        let Some(source) = self.known.get_mut(publisher) else { return false };
        if !source.wanted {
            self.known.remove(publisher);
            return false;
        }
        let is_stable = |since| now.saturating_duration_since(since) >= STABLE_AFTER;
        if matches!(source.state, SourceState::Connected { since } if is_stable(since)) {
            source.backoff = RETRY;
        }
        source.state = SourceState::Waiting { until: now + source.backoff.next_delay() };
        true
    }
}

#[cfg(test)]
#[path = "../../tests/unit/topic/sources.rs"]
mod tests;
