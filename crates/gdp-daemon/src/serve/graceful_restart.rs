//! Links that stay in the data plane though nobody answers on them, or another has replaced them:
//! their peers may still send on them, or forward without a daemon. Each has a time at which it
//! goes; the switch in [`super::core`] removes it then.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use gdp_core::domain::Relationship;
use gdp_link::link::{KeyedEntry, Link, LinkId};
use gdp_link::port::LinkAddr;
use gdp_wire::{LinkRole, Name};

/// How long a link is kept that another has replaced: until frames that were sent on it have
/// arrived.
pub const GRACE: Duration = Duration::from_secs(5);

/// Links to one peer that are kept.
const MOST: usize = 8;

/// A link that is kept.
pub struct StaleLink {
    pub peer: Name,
    pub lane: u8,
    pub role: LinkRole,
    pub entry: KeyedEntry,
    pub to: LinkAddr,
    pub until: Instant,
    /// What the peer was to this switch's domain, unless the link is from before this daemon.
    pub relationship: Option<Relationship>,
    /// So that no new link gets the same index in the tables.
    pub id: Reservation,
}

impl StaleLink {
    /// The link itself, unless it is from before this daemon.
    pub fn link(&self) -> Option<&Link> {
        match &self.id {
            Reservation::Closed { link } => Some(link),
            Reservation::Adopted { .. } => None,
        }
    }
}

/// What reserves the id of a link that is kept.
pub enum Reservation {
    Adopted { _id: LinkId },
    Closed { link: Link },
}

/// All that are kept, by id.
#[derive(Default)]
pub struct GracefulRestart(HashMap<u32, StaleLink>);

impl GracefulRestart {
    /// Keeps a link. Returns one to the same peer that has to go for it.
    pub fn keep(&mut self, link: StaleLink) -> Option<u32> {
        let same_peer = self.0.values().filter(|held| held.peer == link.peer);
        let crowded = same_peer.clone().count() >= MOST;
        let first = same_peer.filter(|_| crowded).min_by_key(|held| held.until).map(|held| held.entry.id);
        self.0.insert(link.entry.id, link);
        first
    }

    pub fn take(&mut self, id: u32) -> Option<StaleLink> {
        self.0.remove(&id)
    }

    pub fn contains(&self, id: u32) -> bool {
        self.0.contains_key(&id)
    }

    pub fn get_mut(&mut self, id: u32) -> Option<&mut StaleLink> {
        self.0.get_mut(&id)
    }

    pub fn iter(&self) -> impl Iterator<Item = &StaleLink> {
        self.0.values()
    }

    /// Whether any link to the peer is kept.
    pub fn keeps(&self, peer: &Name) -> bool {
        self.0.values().any(|held| held.peer == *peer)
    }

    /// The peer takes frames on a new link: what it sent on others of that lane arrives soon, or
    /// never.
    pub fn replaced(&mut self, peer: &Name, lane: u8, now: Instant) {
        let same = |held: &&mut StaleLink| held.peer == *peer && held.lane == lane;
        for held in self.0.values_mut().filter(same) {
            held.until = held.until.min(now + GRACE);
        }
    }

    /// Those whose time is over.
    pub fn over(&self, now: Instant) -> Vec<u32> {
        self.0.values().filter(|held| held.until <= now).map(|held| held.entry.id).collect()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/graceful_restart.rs"]
mod tests;
