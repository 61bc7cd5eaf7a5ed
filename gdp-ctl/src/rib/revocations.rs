//! The newest revocation of each name: what its owner has taken back. Kept while anybody has a part in the name, and after
//! that as long as there is room.

use std::collections::{BTreeMap, HashMap};

use gdp::cert::Revocation;
use gdp::revocations::Kept;
use gdp_wire::Name;

use super::names::Key;

/// Where a revocation came in. A flood of them pushes out those of its own source first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Origin {
    pub switch: Name,
    pub by_tool: bool,
}

#[derive(Debug)]
pub(super) struct Held {
    pub kept: Kept,
    pub claims: Revocation,
    origin: Origin,
    /// Its place among those of names that nobody has a part in.
    idle: Option<u64>,
}

#[derive(Debug, Default)]
pub(super) struct Revocations {
    held: BTreeMap<Key, Held>,
    /// Those of names that nobody has a part in, the one that has been so for longest first.
    idle: HashMap<Origin, BTreeMap<u64, Key>>,
    idle_count: usize,
    next: u64,
    changes: u64,
}

impl Revocations {
    pub fn get(&self, name: &Key) -> Option<&Held> {
        self.held.get(name)
    }

    pub fn claims(&self, name: &Key) -> Option<&Revocation> {
        self.held.get(name).map(|held| &held.claims)
    }

    /// Keeps a verified revocation that [replaces](Revocation::check_replaces) the one that is held. Follow with
    /// [`Self::leave`] if nobody has a part in the name.
    pub fn put(&mut self, name: Key, kept: Kept, claims: Revocation, origin: Origin) {
        self.enter(&name);
        self.held.insert(name, Held { kept, claims, origin, idle: None });
        self.changes += 1;
    }

    /// Rises whenever one is put.
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// Those of names that somebody has a part in, then the others, the one that has been so for longest last.
    pub fn all(&self) -> Vec<Kept> {
        let mut all: Vec<&Held> = self.held.values().collect();
        all.sort_by_key(|held| held.idle.map_or(0, |place| u64::MAX - place));
        all.into_iter().map(|held| held.kept.clone()).collect()
    }

    /// Somebody has a part in the name.
    pub fn enter(&mut self, name: &Key) {
        let Some(held) = self.held.get_mut(name) else { return };
        let Some(place) = held.idle.take() else { return };
        if let Some(idle) = self.idle.get_mut(&held.origin) {
            idle.remove(&place);
            if idle.is_empty() {
                self.idle.remove(&held.origin);
            }
        }
        self.idle_count -= 1;
    }

    /// Nobody has a part in the name any more. Of more than `limit` such the oldest goes, of the source that has most.
    pub fn leave(&mut self, name: &Key, limit: usize) {
        let Some(held) = self.held.get_mut(name).filter(|held| held.idle.is_none()) else { return };
        self.next += 1;
        held.idle = Some(self.next);
        self.idle.entry(held.origin).or_default().insert(self.next, *name);
        self.idle_count += 1;
        if self.idle_count > limit
            && let Some(most) = self.idle.values().max_by_key(|idle| idle.len())
            && let Some(oldest) = most.values().next().copied()
        {
            self.enter(&oldest);
            self.held.remove(&oldest);
        }
    }
}
