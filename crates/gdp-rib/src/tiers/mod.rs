//! Tiers: the protocol by which the RIBs of different domains announce the publishers and readers
//! of names to each other. It performs no I/O: time, the own RIB's records and the requests of
//! neighbours go in. Messages to neighbours ([`Effect`]) and the records of other domains for the
//! own RIB ([`TierChange`]) come out. It has no sockets and no clock; the daemon transports the
//! messages.
//!
//! A domain has parents, in order, and children, to any depth. [`spread`] selects what each
//! neighbour is told, and a [`Feed`](crate::feed::Feed) keeps both ends the same. Each record
//! carries the path of domains that it passed. A domain refuses a record whose path contains it,
//! and a parent that has it as an ancestor. No neighbour is trusted: [`verification`] verifies
//! everything again.
//!
//! A lying neighbour can only withhold records, and state what its own domain alone may state.

mod endings;
mod incoming;
mod interest;
mod limits;
mod outgoing;
pub mod peering;
mod queries;
mod refusal;
mod side;
mod spread;
mod table;
#[cfg(test)]
#[path = "../../tests/unit/tiers/mod.rs"]
pub mod tests;
mod ticket;
mod verification;

pub use crate::tiers::limits::TierLimits;
pub use crate::tiers::ticket::Ticket;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::{CertError, Locator, Signed};
use gdp_core::keys::KeyBox;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control::{Record, RecordKey, TierHolds, TierKey, TierRequest, TierResponse};
use gdp_wire::Name;

use crate::deadlines::Deadlines;
use crate::feed::Room;
use crate::rib::Now;
use queries::Queries;
use side::{SentUpdate, Side};
use table::RecordTable;

pub use crate::tiers::refusal::TierRefusal;
pub use side::{DomainRelation, OfEntity, RESTART_TIME, SILENCE, SessionState};
pub use table::{Hosted, Item, TableRecord};
pub use verification::Revoked;

/// Message to send.
#[derive(Debug)]
pub enum Effect {
    /// Request to the RIB of a neighbouring domain, to be answered with [`Tiers::answered`].
    Ask { to: Name, sent: Sent, request: TierRequest },
    /// Answer to the query with this ticket.
    Answer { ticket: Ticket, response: TierResponse },
}

/// Identifies a sent message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// `run` is the one in the message. The neighbour's session may have been replaced when the
    /// answer arrives.
    Hello {
        run: u64,
    },
    Push(TierHolds),
    Query(Ticket),
}

#[derive(Debug)]
pub enum Reply {
    Now(TierResponse),
    /// An [`Effect::Answer`] follows later.
    Later(Ticket),
}

/// Change of what the own RIB may know of other domains.
#[derive(Clone, Debug)]
pub enum TierChange {
    Set(Item),
    Remove(TierKey),
}

/// State of a neighbouring domain, as `gdp-ctl` shows it.
#[derive(Clone, Debug)]
pub struct Neighbour {
    pub domain: Name,
    pub kind: DomainRelation,
    pub session: SessionState,
    /// Number of entries received from it, and of those sent to it.
    pub entries_in: usize,
    pub entries_out: usize,
    /// Number of its refused messages and entries, by reason.
    pub refused: BTreeMap<&'static str, u64>,
    /// Reason why the neighbour accepts only part of what it is sent.
    pub lacking: Option<String>,
}

/// The tiers as seen by one domain's RIB.
#[derive(Debug)]
pub struct Tiers {
    home: Name,
    /// Run number of the newest session.
    run: u64,
    limits: TierLimits,
    /// Parents in the order in which they are queried.
    parents: Vec<Name>,
    /// Domains with a border link at present.
    adjacent: BTreeSet<Name>,
    sides: BTreeMap<Name, Side>,
    /// Entries of the own RIB, and the entries that it may know.
    own: RecordTable,
    known: SentUpdate,
    changed_names: BTreeSet<Name>,
    changed_writers: BTreeSet<Name>,
    changed_locators: BTreeSet<Name>,
    /// End of each announced entry, by neighbour and key.
    endings: Deadlines<(Name, TierKey)>,
    queries: Queries,
    answers: Vec<(Ticket, TierResponse)>,
    /// Revocations received from neighbours since the last call of [`Self::take_revoked`].
    received_revocations: Vec<SignedRevocation>,
    /// Number of messages from domains that are neither parent nor child.
    unknown_domains: u64,
}

/// Announcements of the own domain, and queries of its state.
impl Tiers {
    /// Creates the tiers of domain `home`.
    ///
    /// Each session with a neighbour gets its own run number above `run`. Nanoseconds since a fixed
    /// time serve as `run`, because they exceed every number that an earlier RIB used.
    pub fn new(home: Name, run: u64, limits: TierLimits) -> Self {
        Self {
            home,
            run,
            limits,
            parents: Vec::new(),
            adjacent: BTreeSet::new(),
            sides: BTreeMap::new(),
            own: RecordTable::default(),
            known: SentUpdate::default(),
            changed_names: BTreeSet::new(),
            changed_writers: BTreeSet::new(),
            changed_locators: BTreeSet::new(),
            endings: Deadlines::default(),
            queries: Queries::default(),
            answers: Vec::new(),
            received_revocations: Vec::new(),
            unknown_domains: 0,
        }
    }

    /// Sets the parent domains, in the order in which they are queried.
    pub fn set_parents(&mut self, now: Now, parents: Vec<Name>) {
        if self.parents == parents {
            return;
        }
        let is_other = |(domain, side): &(&Name, &Side)| side.kind.is_parent() != parents.contains(domain);
        let others: Vec<Name> = self.sides.iter().filter(is_other).map(|(domain, _)| *domain).collect();
        for domain in others {
            self.clear(domain);
            self.sides.remove(&domain);
        }
        for (index, parent) in parents.iter().enumerate().filter(|(_, parent)| **parent != self.home) {
            let kind = DomainRelation::Parent(index);
            let new = || {
                self.run += 1;
                Side::new(now.clock, kind, self.run)
            };
            self.sides.entry(*parent).or_insert_with(new).kind = kind;
        }
        self.parents = parents;
        self.all_changed();
    }

    /// Sets the domains that have a border link at present.
    pub fn set_adjacent(&mut self, now: Now, adjacent: BTreeSet<Name>) {
        for (domain, side) in &mut self.sides {
            match (self.adjacent.contains(domain), adjacent.contains(domain)) {
                (true, false) => side.lose(now.clock),
                (false, true) => side.hello_at = now.clock,
                _ => {}
            }
        }
        self.adjacent = adjacent;
    }

    /// Announces an entity's registration in this domain, verified by its RIB, with the switch of
    /// its attachment. A registration that only this domain may know is not stored.
    pub fn set_own(&mut self, now: Now, record: Record, host: Arc<Hosted>) -> Result<(), CertError> {
        let place = record.key()?;
        let scope = record.credential.scope()?;
        if record.is_writer() && scope.iter().all(|domain| *domain == self.home) {
            self.remove_own(place);
            return Ok(());
        }
        let ends = now.clock + Duration::from_secs(record.expires_in);
        let held = TableRecord { key: place, record, host, path: Vec::new(), scope, ends };
        let key = TierKey::Part(place);
        if self.own.insert(key, Item::part(Arc::new(held))) {
            self.changed(key);
        }
        Ok(())
    }

    pub fn remove_own(&mut self, place: RecordKey) {
        let key = TierKey::Part(place);
        if self.own.remove(&key).is_some() {
            self.changed(key);
        }
    }

    /// Replaces all key boxes of a writer in this domain, each wrapped for one reader.
    pub fn set_own_boxes(&mut self, writer: Name, boxes: Vec<Signed<KeyBox>>) -> Result<(), CertError> {
        let mut left: BTreeSet<TierKey> = self.own.boxes_of(writer).map(|(key, _)| *key).collect();
        for signed in boxes {
            let KeyBox { name, reader, epoch, .. } = signed.claims_unverified()?;
            let key = TierKey::Box { writer, reader, name, epoch };
            left.remove(&key);
            self.own.insert(key, Item::Box(Arc::new(signed)));
        }
        left.iter().for_each(|key| drop(self.own.remove(key)));
        self.changed_writers.insert(writer);
        Ok(())
    }

    /// Sets the locator of this domain. A locator without borders removes it.
    pub fn set_own_locator(&mut self, locator: Locator) {
        let (key, domain) = (TierKey::Locator(self.home), self.home);
        let changed = match locator.borders.is_empty() {
            true => self.own.remove(&key).is_some(),
            false => self.own.insert(key, Item::Locator { domain, locator: Arc::new(locator) }),
        };
        if changed {
            self.changed(key);
        }
    }

    /// Returns the changes of what the own RIB may know of other domains.
    pub fn take_changes(&mut self, now: Now) -> Vec<TierChange> {
        self.spread();
        let everything = Room { entries: usize::MAX, bytes: usize::MAX };
        let Some(parcel) = self.known.feed.next(now.clock, everything, |_| 0) else { return Vec::new() };
        self.known.feed.answered(now.clock, parcel.generation, true);
        let removed = parcel.remove.into_iter().map(TierChange::Remove);
        removed.chain(parcel.set.into_iter().map(TierChange::Set)).collect()
    }

    /// Returns the verified revocations that neighbours announced in [requests](Self::request)
    /// since the last call.
    ///
    /// The own RIB must store them and then [reconsider](Self::reconsider) each name.
    pub fn take_revoked(&mut self) -> Vec<SignedRevocation> {
        std::mem::take(&mut self.received_revocations)
    }

    /// Returns the registrations and key boxes of an entity of another domain that the own RIB may
    /// know.
    pub fn known_of(&self, entity: Name) -> OfEntity {
        self.known.of(entity)
    }

    /// Returns the known record with this key, and whether it only passes through this domain.
    pub fn known_at(&self, place: &RecordKey) -> Option<(Arc<TableRecord>, bool)> {
        match self.known.feed.entries().get(&TierKey::Part(*place)) {
            Some(Item::Part { record: held, only_passes }) => Some((held.clone(), *only_passes)),
            _ => None,
        }
    }

    pub fn parents(&self) -> &[Name] {
        &self.parents
    }

    /// Returns the locator of another domain, if the own RIB knows it.
    pub fn locator(&self, domain: Name) -> Option<&Locator> {
        match self.known.feed.entries().get(&TierKey::Locator(domain)) {
            Some(Item::Locator { locator, .. }) => Some(locator),
            _ => None,
        }
    }

    /// Returns the domains with entities that exchange messages with entities of this one.
    pub fn concerned(&self) -> impl Iterator<Item = &Name> {
        self.known.origins()
    }

    pub fn neighbours(&self) -> impl Iterator<Item = Neighbour> {
        self.sides.iter().map(|(domain, side)| Neighbour {
            domain: *domain,
            kind: side.kind,
            session: side.session.clone(),
            entries_in: side.table.len(),
            entries_out: side.sent.feed.entries().len(),
            refused: side.refused.clone(),
            lacking: side.lacking.clone(),
        })
    }

    /// Returns the number of messages from domains that are neither parent nor child.
    pub fn unknown_domains(&self) -> u64 {
        self.unknown_domains
    }
}

/// Change marks and refusal counters.
impl Tiers {
    fn changed(&mut self, key: TierKey) {
        match key {
            TierKey::Part(place) => {
                self.queries.answered_for(place.name);
                self.changed_names.insert(place.name);
            }
            TierKey::Box { writer, .. } => drop(self.changed_writers.insert(writer)),
            TierKey::Locator(domain) => drop(self.changed_locators.insert(domain)),
            // No table stores revocations.
            TierKey::Revocation(_) => {}
        }
    }

    /// Marks all names as changed after a neighbour was added, removed or changed.
    fn all_changed(&mut self) {
        let tables = self.sides.values().map(|side| &side.table).chain([&self.own]);
        let names = tables.flat_map(RecordTable::parts).map(|held| held.key.name);
        self.changed_names.extend(names);
    }

    fn count(&mut self, of: Name, what: &'static str) {
        if let Some(side) = self.sides.get_mut(&of) {
            side.count(what);
        }
    }
}
