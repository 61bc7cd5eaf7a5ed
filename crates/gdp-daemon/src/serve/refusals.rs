//! Why there is no link with a peer: the last reason, of the peers that most recently had one. For `gdp-ctl peer list`.

use std::collections::HashMap;
use std::time::Instant;

use gdp_wire::Name;

/// Anybody can be refused a link, so few are remembered.
const MAX_PEERS: usize = 128;

#[derive(Debug, Default)]
pub struct Refusals(HashMap<Name, Refused>);

/// The last time that a peer got no link.
#[derive(Debug)]
pub struct Refused {
    pub reason: String,
    pub at: Instant,
}

impl Refusals {
    pub fn add(&mut self, peer: Name, reason: String, at: Instant) {
        if self.0.len() >= MAX_PEERS && !self.0.contains_key(&peer) {
            let oldest = self.0.iter().min_by_key(|(_, refused)| refused.at).map(|(peer, _)| *peer);
            oldest.and_then(|oldest| self.0.remove(&oldest));
        }
        self.0.insert(peer, Refused { reason, at });
    }

    /// The peer has a link now.
    pub fn forget(&mut self, peer: &Name) {
        self.0.remove(peer);
    }

    pub fn iter(&self) -> impl Iterator<Item = (&Name, &Refused)> {
        self.0.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn the_oldest_make_room() {
        let (mut refusals, start) = (Refusals::default(), Instant::now());
        let name = |i: u8| Name::from_bytes([i; 32]);
        for i in 0..=MAX_PEERS as u8 {
            refusals.add(name(i), i.to_string(), start + Duration::from_secs(i.into()));
        }
        assert_eq!(refusals.iter().count(), MAX_PEERS);
        assert!(refusals.iter().all(|(peer, _)| *peer != name(0)));
        refusals.add(name(9), "again".into(), start);
        assert_eq!(refusals.iter().count(), MAX_PEERS, "a peer that is there takes no room");
        refusals.forget(&name(9));
        assert!(refusals.iter().all(|(_, refused)| refused.reason != "again"));
    }
}
