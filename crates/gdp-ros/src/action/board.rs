//! Merges the goal statuses of several servers into one list.

use std::collections::BTreeMap;
use std::time::Instant;

use bytes::Bytes;
use gdp_wire::Name;

use super::LINGER;
use super::cdr::{ABORTED, MAX_GOALS, Malformed, Status, status_array, statuses};

/// Maximum number of departed servers whose goals are still shown.
const MAX_LEFT: usize = 64;

/// The goal statuses of an action whose servers are remote.
#[derive(Default)]
pub struct Board {
    servers: BTreeMap<Name, ServerStatuses>,
}

struct ServerStatuses {
    statuses: Vec<Status>,
    left: Option<Instant>,
}

impl Board {
    /// Stores the status array of a server. Returns the goals that have ended.
    pub fn say(&mut self, server: Name, message: &[u8]) -> Result<Vec<Status>, Malformed> {
        let statuses = statuses(message)?;
        let ended = statuses.iter().filter(|status| status.is_final()).copied().collect();
        self.servers.insert(server, ServerStatuses { statuses, left: None });
        Ok(ended)
    }

    /// Marks a server as departed and its active goals as aborted. Returns whether any goal
    /// changed.
    pub fn leave(&mut self, now: Instant, server: &Name) -> bool {
        let Some(server) = self.servers.get_mut(server) else { return false };
        server.left.get_or_insert(now);
        let mut lost = false;
        for status in server.statuses.iter_mut().filter(|status| !status.is_final()) {
            (status.status, lost) = (ABORTED, true);
        }
        let left = |server: &ServerStatuses| server.left;
        while self.servers.values().filter_map(left).count() > MAX_LEFT {
            let oldest = self.servers.iter().filter_map(|(name, server)| Some((server.left?, *name))).min();
            oldest.and_then(|(_, name)| self.servers.remove(&name));
        }
        lost
    }

    /// Removes servers that left [`LINGER`] ago. Returns whether any was removed.
    pub fn sweep(&mut self, now: Instant) -> bool {
        let before = self.servers.len();
        self.servers.retain(|_, server| server.left.is_none_or(|left| now.saturating_duration_since(left) < LINGER));
        self.servers.len() < before
    }

    /// Returns the statuses of all servers as a `GoalStatusArray`.
    pub fn message(&self) -> Bytes {
        let all = self.servers.values().flat_map(|server| &server.statuses).copied();
        status_array(&all.take(MAX_GOALS).collect::<Vec<_>>())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/action/board.rs"]
mod tests;
