//! Stale links. They stay in the data plane although the peer is silent or has a newer link.
//!
//! The peer may still send on them, or forward without a daemon (compare graceful restart, RFC
//! 4724). Each has an expiry, at which the switch in [`super::core`] removes it.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use gdp_core::domain::Relationship;
use gdp_link::link::{KeyedEntry, Link, LinkId};
use gdp_link::port::LinkAddr;
use gdp_wire::{LinkRole, Name};

/// How long a replaced link is kept, so that frames sent on it can arrive.
pub const GRACE: Duration = Duration::from_secs(5);

/// The maximum number of stale links to one peer.
const MOST: usize = 8;

/// A stale link.
pub struct StaleLink {
    pub peer: Name,
    pub lane: u8,
    pub role: LinkRole,
    pub entry: KeyedEntry,
    pub to: LinkAddr,
    pub until: Instant,
    /// Whether the data plane at the other end answers echoes, as far as it is asked. Frames use
    /// the link only while it does.
    pub answers: bool,
    /// The peer's relationship to this switch's domain. `None` for a link of an earlier daemon.
    pub relationship: Option<Relationship>,
    /// Reserves the link id, so that no new link gets the same table index.
    pub id: Reservation,
}

impl StaleLink {
    /// Returns the link itself. `None` for a link of an earlier daemon.
    pub fn link(&self) -> Option<&Link> {
        match &self.id {
            Reservation::Closed { link } => Some(link),
            Reservation::Adopted { .. } => None,
        }
    }
}

/// The owner that keeps a stale link's id reserved.
pub enum Reservation {
    Adopted { _id: LinkId },
    Closed { link: Link },
}

/// All stale links, by id.
#[derive(Default)]
pub struct GracefulRestart(HashMap<u32, StaleLink>);

impl GracefulRestart {
    /// Adds a stale link. Returns the link to the same peer that must go for it, the one that
    /// expires first.
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

    /// Returns whether the peer has a stale link.
    pub fn keeps(&self, peer: &Name) -> bool {
        self.0.values().any(|held| held.peer == *peer)
    }

    /// Shortens the expiry of a peer's stale links of this lane, because it accepts frames on a new
    /// link. Frames on the old links arrive soon or never.
    pub fn replaced(&mut self, peer: &Name, lane: u8, now: Instant) {
        let same = |held: &&mut StaleLink| held.peer == *peer && held.lane == lane;
        for held in self.0.values_mut().filter(same) {
            held.until = held.until.min(now + GRACE);
        }
    }

    /// Returns the ids of the expired links.
    pub fn over(&self, now: Instant) -> Vec<u32> {
        self.0.values().filter(|held| held.until <= now).map(|held| held.entry.id).collect()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/graceful_restart.rs"]
mod tests;
