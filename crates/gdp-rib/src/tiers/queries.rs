//! Queries that this domain cannot answer. They climb to one parent after the other, and each
//! parent queries its own. Unanswered names are cached for a while, so that repeated queries cost
//! only this RIB. A query is not a subscription.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_wire::Name;

use crate::tiers::ticket::Ticket;

/// Time to wait for the answer of one parent.
pub const TIMEOUT: Duration = Duration::from_secs(2);

/// Time for which a negative answer is cached.
pub const MISSED: Duration = Duration::from_secs(10);

const MAX_MISSED: usize = 4096;

/// Maximum number of concurrent climbing queries, in total and per neighbour.
const MAX_CLIMBING: usize = 1024;
const MAX_CLIMBING_FOR_ONE: usize = 128;

/// Query that is being sent to parents.
#[derive(Debug)]
pub struct Climbing {
    pub name: Name,
    /// Path of the query as sent to parents. This domain is the last.
    pub path: Vec<Name>,
    /// Neighbour that waits for the answer. `None` if this domain itself asked.
    pub asked_by: Option<Name>,
    /// Parents still to query, the next one last.
    pub left: Vec<Name>,
    /// Parent that is queried at present.
    pub at: Option<Name>,
    pub until: Duration,
}

#[derive(Debug, Default)]
pub struct Queries {
    next: u64,
    pub climbing: BTreeMap<Ticket, Climbing>,
    /// Negative answers by name and asking domain, each with its expiry.
    missed: BTreeMap<(Name, Name), Duration>,
    missed_until: BTreeSet<(Duration, (Name, Name))>,
}

impl Queries {
    /// Returns whether one more query of this neighbour, or of this domain, may climb.
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

    /// Caches a negative answer for `name` to `domain`.
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

    /// Removes the negative answers for a name that has become known.
    pub fn answered_for(&mut self, name: Name) {
        let nobody = Name::default();
        let all: Vec<_> = self.missed.range((name, nobody)..).take_while(|((of, _), _)| *of == name).collect();
        let all: Vec<_> = all.into_iter().map(|(key, until)| (*until, *key)).collect();
        for (until, key) in all {
            self.missed.remove(&key);
            self.missed_until.remove(&(until, key));
        }
    }

    /// Removes expired negative answers.
    pub fn expire(&mut self, now: Duration) {
        while let Some((until, key)) = self.missed_until.first().copied().filter(|(until, _)| *until <= now) {
            self.missed_until.remove(&(until, key));
            self.missed.remove(&key);
        }
    }

    /// Returns the queries whose present parent has timed out.
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
