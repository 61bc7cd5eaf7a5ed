//! Tiers: how the RIBs of different domains tell each other who publishes and reads which name.
//! Sans-IO: time, what the own RIB knows and what neighbours say go in; messages to neighbours
//! ([`Effect`]) and what the own RIB may know of other domains ([`TierChange`]) come out. No
//! sockets, no clock; the daemon moves what travels.
//!
//! A domain has parents, in order, and children; any depth. To each it tells what [`spread`]
//! chooses, kept the same at both ends by a [`Feed`](crate::feed::Feed). Each record carries the
//! domains it came through: a domain that finds itself there refuses it, as it refuses a parent
//! that it is above of. Nothing is believed because of who says it: [`verification`] verifies all
//! again.
//!
//! What a neighbour that lies can do is to withhold, and to say what its own domain alone may say.

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
pub use side::{Kind, OfEntity, RESTART_TIME, SILENCE, SessionState};
pub use table::{Hosted, Item, TableRecord};
pub use verification::Revoked;

/// What is to be sent.
#[derive(Debug)]
pub enum Effect {
    /// To the RIB of a neighbouring domain. To be answered with [`Tiers::answered`].
    Ask { to: Name, sent: Sent, request: TierRequest },
    /// To who waits for this ticket.
    Answer { ticket: Ticket, response: TierResponse },
}

/// Which message it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// `run`: as in the message, which may be of a side that is no more when the answer comes.
    Hello {
        run: u64,
    },
    Push(TierHolds),
    Query(Ticket),
}

#[derive(Debug)]
pub enum Reply {
    Now(TierResponse),
    /// An [`Effect::Answer`] comes.
    Later(Ticket),
}

/// What the own RIB may know of other domains now.
#[derive(Clone, Debug)]
pub enum TierChange {
    Set(Item),
    Remove(TierKey),
}

/// A neighbouring domain, as `gdp-ctl` shows it.
#[derive(Clone, Debug)]
pub struct Neighbour {
    pub domain: Name,
    pub kind: Kind,
    pub session: SessionState,
    /// Entries that it says, and that it is told.
    pub entries_in: usize,
    pub entries_out: usize,
    /// What was refused of it, by reason.
    pub refused: BTreeMap<&'static str, u64>,
    /// Why it takes in only a part of what it is told.
    pub lacking: Option<String>,
}

/// The tiers as one domain's RIB sees them.
#[derive(Debug)]
pub struct Tiers {
    home: Name,
    /// Of the side that was made last.
    run: u64,
    limits: TierLimits,
    /// In the order in which they are asked.
    parents: Vec<Name>,
    /// Domains that there is a border link to now.
    adjacent: BTreeSet<Name>,
    sides: BTreeMap<Name, Side>,
    /// What the own RIB says, and what it may know.
    own: RecordTable,
    known: SentUpdate,
    changed_names: BTreeSet<Name>,
    changed_writers: BTreeSet<Name>,
    changed_locators: BTreeSet<Name>,
    /// When what neighbours said ends: by neighbour and what it is about.
    endings: Deadlines<(Name, TierKey)>,
    queries: Queries,
    answers: Vec<(Ticket, TierResponse)>,
    /// What owners have taken back, as neighbours have said since somebody last asked.
    received_revocations: Vec<SignedRevocation>,
    /// Messages of domains that are neither parent nor child.
    unknown_domains: u64,
}

/// What the own domain says of itself.
impl Tiers {
    /// Of domain `home`. What it tells neighbours is of runs above `run`, one for each that comes:
    /// nanoseconds since any fixed time do, as they are ahead of whatever an earlier RIB has come
    /// to.
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

    /// The domains whose RIBs are above this one, in the order in which they are asked.
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
            let kind = Kind::Parent(index);
            let new = || {
                self.run += 1;
                Side::new(now.clock, kind, self.run)
            };
            self.sides.entry(*parent).or_insert_with(new).kind = kind;
        }
        self.parents = parents;
        self.all_changed();
    }

    /// The domains that there is a link to now.
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

    /// What an entity has stated in this domain, verified by its RIB, with the switch it is
    /// attached to. Of what is for this domain alone nothing is kept.
    pub fn set_own(&mut self, now: Now, record: Record, host: Arc<Hosted>) -> Result<(), CertError> {
        let place = record.place()?;
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

    /// All keys of a writer in this domain, each wrapped for one reader.
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

    /// Where this domain can be reached; nowhere, if no border is named.
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

    /// What the own RIB may know of other domains, as far as it has changed.
    pub fn take_changes(&mut self, now: Now) -> Vec<TierChange> {
        self.spread();
        let everything = Room { entries: usize::MAX, bytes: usize::MAX };
        let Some(parcel) = self.known.feed.next(now.clock, everything, |_| 0) else { return Vec::new() };
        self.known.feed.answered(now.clock, parcel.generation, true);
        let removed = parcel.remove.into_iter().map(TierChange::Remove);
        removed.chain(parcel.set.into_iter().map(TierChange::Set)).collect()
    }

    /// What owners of names have taken back, as a neighbour has said in the last
    /// [request](Self::request); verified. The own RIB is to keep it, and then
    /// [reconsider](Self::reconsider) each of these names.
    pub fn take_revoked(&mut self) -> Vec<SignedRevocation> {
        std::mem::take(&mut self.received_revocations)
    }

    /// What the own RIB may know of an entity of another domain, with the keys it has for readers
    /// here.
    pub fn known_of(&self, entity: Name) -> OfEntity {
        self.known.of(entity)
    }

    /// The part at a place that the own RIB may know, and whether it only passes through this
    /// domain.
    pub fn known_at(&self, place: &RecordKey) -> Option<(Arc<TableRecord>, bool)> {
        match self.known.feed.entries().get(&TierKey::Part(*place)) {
            Some(Item::Part { record: held, only_passes }) => Some((held.clone(), *only_passes)),
            _ => None,
        }
    }

    pub fn parents(&self) -> &[Name] {
        &self.parents
    }

    /// Where another domain can be reached, as far as the own RIB is to know.
    pub fn locator(&self, domain: Name) -> Option<&Locator> {
        match self.known.feed.entries().get(&TierKey::Locator(domain)) {
            Some(Item::Locator { locator, .. }) => Some(locator),
            _ => None,
        }
    }

    /// The domains in which somebody exchanges messages with somebody in this one.
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

    /// Messages of domains that are neither parent nor child.
    pub fn unknown_domains(&self) -> u64 {
        self.unknown_domains
    }
}

/// What has changed, and what is refused.
impl Tiers {
    fn changed(&mut self, key: TierKey) {
        match key {
            TierKey::Part(place) => {
                self.queries.answered_for(place.name);
                self.changed_names.insert(place.name);
            }
            TierKey::Box { writer, .. } => drop(self.changed_writers.insert(writer)),
            TierKey::Locator(domain) => drop(self.changed_locators.insert(domain)),
            // Of these no side holds any.
            TierKey::Revocation(_) => {}
        }
    }

    /// A neighbour came or went, or is another than before.
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
