//! The last reason why a peer got no link, for the most recently refused peers. `gdp-ctl peer list`
//! shows them.

use std::collections::HashMap;
use std::time::Instant;

use gdp_util::line_limit::differ_in_digits_at_most;
use gdp_wire::Name;

/// The maximum number of refused peers to remember. Any peer may cause a refusal, so it is small.
const MAX_PEERS: usize = 128;

#[derive(Debug, Default)]
pub struct Refusals(HashMap<Name, Refused>);

/// The last refusal of a peer.
#[derive(Debug)]
pub struct Refused {
    pub reason: String,
    pub at: Instant,
}

impl Refusals {
    /// Records a refusal. Returns true if the peer was refused for another reason before, or for
    /// none.
    pub fn add(&mut self, peer: Name, reason: String, at: Instant) -> bool {
        if self.0.len() >= MAX_PEERS && !self.0.contains_key(&peer) {
            let oldest = self.0.iter().min_by_key(|(_, refused)| refused.at).map(|(peer, _)| *peer);
            oldest.and_then(|oldest| self.0.remove(&oldest));
        }
        let same = |before: &Refused| differ_in_digits_at_most(&before.reason, &reason);
        let is_new = !self.0.get(&peer).is_some_and(same);
        self.0.insert(peer, Refused { reason, at });
        is_new
    }

    /// Drops the refusal of a peer that has a link now.
    pub fn forget(&mut self, peer: &Name) {
        self.0.remove(peer);
    }

    pub fn iter(&self) -> impl Iterator<Item = (&Name, &Refused)> {
        self.0.iter()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/refusals.rs"]
mod tests;
