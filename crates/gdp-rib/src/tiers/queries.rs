//! Queries that miss climb: to one parent after the other, each of which asks its own. What nobody
//! knows is remembered for a while, so that asking again costs no more than this RIB; who asks is
//! not subscribed to anything.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_wire::Name;

use crate::tiers::ticket::Ticket;

/// How long one parent is waited for.
pub const TIMEOUT: Duration = Duration::from_secs(2);

/// How long it is remembered that nobody knows a name.
pub const MISSED: Duration = Duration::from_secs(10);

const MAX_MISSED: usize = 4096;

/// Queries that climb at a time: in all, and of one neighbour.
const MAX_CLIMBING: usize = 1024;
const MAX_CLIMBING_FOR_ONE: usize = 128;

/// A query that is on its way up.
#[derive(Debug)]
pub struct Climbing {
    pub name: Name,
    /// As it goes to parents: this domain the last.
    pub path: Vec<Name>,
    /// Who waits for it, if it is not this domain's own.
    pub asked_by: Option<Name>,
    /// The parents that are still to be asked, the next one last.
    pub left: Vec<Name>,
    /// The one that is asked now.
    pub at: Option<Name>,
    pub until: Duration,
}

#[derive(Debug, Default)]
pub struct Queries {
    next: u64,
    pub climbing: BTreeMap<Ticket, Climbing>,
    /// Names that nobody knew, and the domains they were asked for; with when that is forgotten.
    missed: BTreeMap<(Name, Name), Duration>,
    missed_until: BTreeSet<(Duration, (Name, Name))>,
}

impl Queries {
    /// Whether one more query of this neighbour, or of this domain, may climb.
    pub fn has_room(&self, asked_by: Option<Name>) -> bool {
        let for_one = self.climbing.values().filter(|climbing| climbing.asked_by == asked_by).count();
        self.climbing.len() < MAX_CLIMBING && for_one < MAX_CLIMBING_FOR_ONE
    }

    pub fn begin(&mut self, climbing: Climbing) -> Ticket {
        self.next += 1;
        let ticket = Ticket(self.next);
        self.climbing.insert(ticket, climbing);
        ticket
    }

    /// Nobody knew `name` when it was asked for `domain`.
    pub fn miss(&mut self, now: Duration, name: Name, domain: Name) {
        let key = (name, domain);
        if self.missed.len() >= MAX_MISSED
            && !self.missed.contains_key(&key)
            && let Some((_, oldest)) = self.missed_until.pop_first()
        {
            self.missed.remove(&oldest);
        }
        let until = now + MISSED;
        if let Some(before) = self.missed.insert(key, until) {
            self.missed_until.remove(&(before, key));
        }
        self.missed_until.insert((until, key));
    }

    pub fn has_missed(&self, name: Name, domain: Name) -> bool {
        self.missed.contains_key(&(name, domain))
    }

    /// Something is known of the name now.
    pub fn answered_for(&mut self, name: Name) {
        let nobody = Name::default();
        let all: Vec<_> = self.missed.range((name, nobody)..).take_while(|((of, _), _)| *of == name).collect();
        let all: Vec<_> = all.into_iter().map(|(key, until)| (*until, *key)).collect();
        for (until, key) in all {
            self.missed.remove(&key);
            self.missed_until.remove(&(until, key));
        }
    }

    /// Forgets what was missed long ago.
    pub fn expire(&mut self, now: Duration) {
        while let Some((until, key)) = self.missed_until.first().copied().filter(|(until, _)| *until <= now) {
            self.missed_until.remove(&(until, key));
            self.missed.remove(&key);
        }
    }

    /// The queries whose parent has been waited for long enough.
    pub fn overdue(&self, now: Duration) -> Vec<Ticket> {
        let overdue = self.climbing.iter().filter(|(_, climbing)| climbing.until <= now);
        overdue.map(|(ticket, _)| *ticket).collect()
    }

    pub fn next_tick(&self) -> Option<Duration> {
        let missed = self.missed_until.first().map(|(until, _)| *until);
        self.climbing.values().map(|climbing| climbing.until).chain(missed).min()
    }

    #[cfg(test)]
    pub fn missed(&self) -> usize {
        self.missed.len()
    }
}
