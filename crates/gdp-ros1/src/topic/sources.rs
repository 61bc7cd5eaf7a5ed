//! Selects the publishers of a topic to connect to, without I/O. It stores the master's list, the
//! state of each connection, and the time of the next attempt.
//!
//! A publisher may be missing from the master's list though its connection works. A restarted
//! master knows only the nodes that registered since, and most ROS 1 nodes register only once. So
//! the current run of the master ends a connection only if it listed that publisher before. A
//! publisher that it never listed stays until its connection ends.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::time::{Duration, Instant};

use gdp_util::backoff::Backoff;

/// The backoff before a new connection to a publisher.
const RETRY: Backoff = Backoff::new(Duration::from_millis(200), Duration::from_secs(10));

/// Maximum number of publishers of one topic.
pub const MAX_SOURCES: usize = 1024;

/// Minimum duration of a connection that resets the backoff.
const STABLE_AFTER: Duration = Duration::from_secs(5);

/// The publishers of one topic, by the URIs of their slave APIs.
pub struct Sources {
    own: String,
    known: BTreeMap<String, PublisherSource>,
}

struct PublisherSource {
    /// The last run of the master that listed the publisher.
    listed: u64,
    /// Whether the master lists the publisher.
    wanted: bool,
    state: SourceState,
    backoff: Backoff,
}

enum SourceState {
    Waiting { until: Instant },
    Connecting,
    Connected { since: Instant },
}

/// An action that the caller must take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceAction {
    /// Connect to the publisher. The caller must call [`Sources::ended`] when the connection ends.
    Connect(String),
    /// End the connection, if there is one, and forget the publisher.
    Drop(String),
}

impl Sources {
    /// Creates an empty list. `own` is the URI of this node's slave API, to which it never
    /// connects.
    pub fn new(own: String) -> Self {
        Self { own, known: BTreeMap::new() }
    }

    /// Applies the master's list of publishers. `run` is the number of the master's run.
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

    /// Returns the connections whose next attempt is due.
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

    /// Returns the time of the next attempt.
    pub fn next_due(&self) -> Option<Instant> {
        let waiting = |source: &PublisherSource| match source.state {
            SourceState::Waiting { until } => Some(until),
            SourceState::Connecting | SourceState::Connected { .. } => None,
        };
        self.known.values().filter_map(waiting).min()
    }

    /// Records that a connection was established.
    pub fn connected(&mut self, publisher: &str, now: Instant) {
        if let Some(source) = self.known.get_mut(publisher) {
            source.state = SourceState::Connected { since: now };
        }
    }

    /// Records that a connection has ended or failed. Returns whether there will be a new attempt.
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
