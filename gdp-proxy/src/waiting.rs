//! What a route waits for. Silence has a reason: the statistics and `/diagnostics` show it at once,
//! and the log once.

use std::time::{Duration, Instant};

use serde::Serialize;

/// Time for which a route waits for the same before the log says so.
const SILENCE: Duration = Duration::from_secs(5);

/// What a route that carries no messages waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Waiting {
    /// `out`: nobody publishes the topic in the local graph.
    LocalPublisher,
    /// `out`: nobody reads the topic in the fabric.
    Reader,
    /// `in`: nobody publishes the topic in the fabric.
    RemotePublisher,
    /// `in`: nobody subscribes to the topic in the local graph.
    LocalSubscriber,
    LocalServer,
    RemoteServer,
    /// The domain's directory has not arrived.
    Directory,
    /// The RIB or the switch refuses the name. The status gives the reason.
    Permission,
    /// No switch answers. The status of the links gives the reason.
    Switch,
}

impl Waiting {
    /// The status of the route, for people.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::LocalPublisher => "waiting for a local publisher",
            Self::Reader => "waiting for a reader",
            Self::RemotePublisher => "waiting for a publisher elsewhere",
            Self::LocalSubscriber => "waiting for a local subscriber",
            Self::LocalServer => "waiting for a local server",
            Self::RemoteServer => "waiting for a server elsewhere",
            Self::Directory => "waiting for the first version",
            Self::Permission => "waiting for permission",
            Self::Switch => "waiting for the switch",
        }
    }

    /// Whether the local ROS graph lacks something.
    pub fn is_local(self) -> bool {
        matches!(self, Self::LocalPublisher | Self::LocalSubscriber | Self::LocalServer)
    }

    /// Whether other log lines give the reason, each time it occurs.
    fn is_logged_elsewhere(self) -> bool {
        matches!(self, Self::Permission | Self::Switch)
    }
}

/// What is known of a topic in one direction.
#[derive(Clone, Copy, Debug)]
pub struct TopicEnds {
    /// `out`: the topic has publishers in the local graph. `in`: it has subscribers there.
    pub local: bool,
    /// `out`: the number of readers in the fabric. `in`: of publishers there. None until the name
    /// is registered.
    pub remote: Option<usize>,
}

impl TopicEnds {
    /// Returns what an outward route waits for.
    pub fn outward(self) -> Option<Waiting> {
        match self {
            Self { local: false, .. } => Some(Waiting::LocalPublisher),
            Self { remote: Some(0), .. } => Some(Waiting::Reader),
            _ => None,
        }
    }

    /// Returns what an inward route waits for.
    pub fn inward(self) -> Option<Waiting> {
        match self {
            Self { remote: Some(0), .. } => Some(Waiting::RemotePublisher),
            Self { local: false, remote: Some(_) } => Some(Waiting::LocalSubscriber),
            _ => None,
        }
    }
}

/// Decides when the log says what a route waits for: once for each reason.
#[derive(Debug, Default)]
pub struct WaitLog {
    current: Option<(Waiting, Instant)>,
    /// The reasons that the log has, one bit each.
    logged: u16,
}

impl WaitLog {
    /// Records the present reason. Returns true if the log is to say it now.
    pub fn look(&mut self, now: Instant, waiting: Option<Waiting>) -> bool {
        let Some(waiting) = waiting else {
            self.current = None;
            return false;
        };
        let since = match self.current {
            Some((before, since)) if before == waiting => since,
            _ => now,
        };
        self.current = Some((waiting, since));
        let bit = 1 << waiting as u16;
        let is_due = now.saturating_duration_since(since) >= SILENCE && self.logged & bit == 0;
        if is_due {
            self.logged |= bit;
        }
        is_due && !waiting.is_logged_elsewhere()
    }

    pub fn current(&self) -> Option<Waiting> {
        self.current.map(|(waiting, _)| waiting)
    }
}

#[cfg(test)]
#[path = "../tests/unit/waiting.rs"]
mod tests;
