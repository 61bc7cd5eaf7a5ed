//! The newest revocation of each name, signed by its owner. A revocation stays while the name has
//! registrations, and after that while there is room. Each origin has its share of the room, here
//! and in the file that outlives the RIB. A flood from one origin thus evicts its own revocations
//! first.

use std::collections::{BTreeMap, HashMap};

use gdp_core::cert::Revocation;
use gdp_core::revocations::{Origin, SignedRevocation};
use gdp_wire::Name;

use super::journal::{Item, Journal};
use crate::rib::model::{Limits, NameBytes};

#[derive(Debug)]
pub(super) struct StoredRevocation {
    pub signed: SignedRevocation,
    pub claims: Revocation,
    /// Position in the order of eviction. `None` while the name has registrations and the
    /// revocation stays.
    idle: Option<u64>,
}

/// Revocations from one origin. Files from before origins were recorded have none.
#[derive(Debug, Default)]
struct Share {
    /// Number of revocations that stay.
    used: usize,
    /// Revocations that may be evicted, the longest idle first.
    idle: BTreeMap<u64, NameBytes>,
}

#[derive(Debug, Default)]
pub(super) struct Revocations {
    stored: BTreeMap<NameBytes, StoredRevocation>,
    shares: HashMap<Option<Origin>, Share>,
    idle_count: usize,
    next: u64,
    changes: u64,
    journal: Journal,
}

impl Revocations {
    pub fn get(&self, name: &NameBytes) -> Option<&StoredRevocation> {
        self.stored.get(name)
    }

    pub fn claims(&self, name: &NameBytes) -> Option<&Revocation> {
        self.stored.get(name).map(|held| &held.claims)
    }

    /// Stores a verified revocation that [replaces](Revocation::check_replaces) the present one.
    /// `is_used` states that the name has registrations.
    pub fn put(
        &mut self,
        name: NameBytes,
        signed: SignedRevocation,
        claims: Revocation,
        is_used: bool,
        limits: &Limits,
    ) {
        self.remove(&name);
        let share = self.shares.entry(signed.origin).or_default();
        share.used += 1;
        self.stored.insert(name, StoredRevocation { signed, claims, idle: None });
        if !is_used || share.used > limits.used_revocations {
            self.leave(&name, limits);
        }
        self.journal.mark(Item::Revocation(Name::from_bytes(name)));
        self.changes += 1;
    }

    pub fn journal(&mut self) -> &mut Journal {
        &mut self.journal
    }

    /// Returns a counter that increases with each stored revocation.
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// Returns all revocations, origins interleaved by equal shares of bytes. Within each origin,
    /// used ones come first, then idle ones, the longest idle last.
    pub fn all(&self) -> Vec<SignedRevocation> {
        let mut all: Vec<&StoredRevocation> = self.stored.values().collect();
        all.sort_by_key(|held| held.idle.map_or(0, |place| u64::MAX - place));
        let mut sizes: HashMap<Option<Origin>, usize> = HashMap::new();
        let before = |held: &&StoredRevocation| {
            let size = sizes.entry(held.signed.origin).or_default();
            let before = *size;
            *size += held.signed.revocation.as_bytes().len();
            before
        };
        all.sort_by_cached_key(before);
        all.into_iter().map(|held| held.signed.clone()).collect()
    }

    /// Marks the revocation of a newly registered name as used. If too many of its origin are used,
    /// it stays evictable.
    pub fn enter(&mut self, name: &NameBytes, limits: &Limits) {
        let Some(held) = self.stored.get_mut(name) else { return };
        let Some(share) = self.shares.get_mut(&held.signed.origin) else { return };
        if share.used < limits.used_revocations
            && let Some(place) = held.idle.take()
        {
            share.idle.remove(&place);
            share.used += 1;
            self.idle_count -= 1;
        }
    }

    /// Marks the revocation of a name without registrations as idle. Above the limit, the oldest
    /// idle one of the origin with the most is evicted.
    pub fn leave(&mut self, name: &NameBytes, limits: &Limits) {
        let Some(held) = self.stored.get_mut(name).filter(|held| held.idle.is_none()) else { return };
        let Some(share) = self.shares.get_mut(&held.signed.origin) else { return };
        self.next += 1;
        held.idle = Some(self.next);
        share.used -= 1;
        share.idle.insert(self.next, *name);
        self.idle_count += 1;
        if self.idle_count > limits.idle_revocations
            && let Some(most) = self.shares.values().max_by_key(|share| share.idle.len())
            && let Some(oldest) = most.idle.values().next().copied()
        {
            self.remove(&oldest);
        }
    }

    fn remove(&mut self, name: &NameBytes) {
        let Some(StoredRevocation { signed, idle, .. }) = self.stored.remove(name) else { return };
        self.journal.mark(Item::Revocation(Name::from_bytes(*name)));
        let Some(share) = self.shares.get_mut(&signed.origin) else { return };
        match idle {
            Some(place) => {
                share.idle.remove(&place);
                self.idle_count -= 1;
            }
            None => share.used -= 1,
        }
        if share.used == 0 && share.idle.is_empty() {
            self.shares.remove(&signed.origin);
        }
    }
}
