//! The newest revocation of each name: what its owner has taken back. Stored while anybody has a
//! part in the name, and after that as long as there is room. Each origin has its share of it, here
//! and in the file that outlives the RIB, so that a flood pushes out those of its own origin first.

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
    /// Its place among those that may go; none while it stays, because somebody has a part in the
    /// name.
    idle: Option<u64>,
}

/// Those that came in at one place; at none: as a file has them from before origins were kept.
#[derive(Debug, Default)]
struct Share {
    /// How many stay.
    used: usize,
    /// Those that may go, the one that has been so for longest first.
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

    /// Keeps a verified revocation that [replaces](Revocation::check_replaces) the one that is
    /// held. `is_used`: somebody has a part in the name.
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

    /// Rises whenever one is put.
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// Those of each origin in turn, as many bytes of one as of another: first those of names that
    /// somebody has a part in, then the others, the one that has been so for longest last.
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

    /// Somebody has a part in the name. If many of its origin are so, it may go all the same.
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

    /// Nobody has a part in the name any more. Of too many such the oldest goes, of the origin that
    /// has most.
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
