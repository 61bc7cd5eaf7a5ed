//! Tiers: how the RIBs of different domains tell each other who publishes and reads which name. Sans-IO: time, what the own RIB knows
//! and what neighbours say go in; messages to neighbours ([`Effect`]) and what the own RIB may know of other domains ([`Change`])
//! come out. No sockets, no clock; the daemon moves what travels.
//!
//! A domain has parents, in order, and children; any depth. To each it tells what [`spread`] chooses, kept the same at both ends by a
//! [`Feed`](crate::feed::Feed). Each record carries the domains it came through: a domain that finds itself there refuses it, as it
//! refuses a parent that it is above of. Nothing is believed because of who says it: [`judge`] verifies all again.
//!
//! What a neighbour that lies can do is to withhold, and to say what its own domain alone may say.

mod incoming;
mod interest;
mod judge;
mod outgoing;
pub mod peering;
mod queries;
mod side;
mod spread;
mod table;
#[cfg(test)]
pub mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use gdp::cert::{CertError, Locator, Membership, Signed};
use gdp::control::{Record, RecordPlace, TierEntry, TierHolds, TierKey, TierRequest, TierResponse};
use gdp::keys::KeyBox;
use gdp_wire::Name;

use crate::feed::Room;
use crate::rib::Now;
use judge::{Judge, Judged};
use queries::{PATIENCE, Queries};
use side::{Side, Told};
use table::Table;

pub use judge::{Revoked, TierRefusal};
pub use side::{HOLD, Kind, OfEntity, SILENCE, Standing};
pub use table::{Held, Item};

/// What is kept of neighbours at most.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub children: usize,
    /// Of each neighbour: records, key boxes and locators together.
    pub entries: usize,
    /// Of each neighbour.
    pub bytes: usize,
    /// Of each neighbour: more than anybody here exchanges messages with in one name (`counterparts` of [`crate::rib::Limits`]), of
    /// writers and readers each.
    pub parts_per_name: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { children: 1024, entries: 1 << 20, bytes: 1 << 30, parts_per_name: 8192 }
    }
}

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

/// Of a query that is answered later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(u64);

#[derive(Debug)]
pub enum Reply {
    Now(TierResponse),
    /// An [`Effect::Answer`] comes.
    Later(Ticket),
}

/// What the own RIB may know of other domains now.
#[derive(Clone, Debug)]
pub enum Change {
    Set(Item),
    Remove(TierKey),
}

/// A neighbouring domain, as `gdp-ctl` shows it.
#[derive(Clone, Debug)]
pub struct Neighbour {
    pub domain: Name,
    pub kind: Kind,
    pub standing: Standing,
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
    limits: Limits,
    /// In the order in which they are asked.
    parents: Vec<Name>,
    /// Domains that there is a border link to now.
    adjacent: BTreeSet<Name>,
    sides: BTreeMap<Name, Side>,
    /// What the own RIB says, and what it may know.
    own: Table,
    known: Told,
    changed_names: BTreeSet<Name>,
    changed_writers: BTreeSet<Name>,
    changed_locators: BTreeSet<Name>,
    endings: Endings,
    queries: Queries,
    answers: Vec<(Ticket, TierResponse)>,
    /// Messages of domains that are neither parent nor child.
    strangers: u64,
}

/// When what neighbours said ends.
#[derive(Debug, Default)]
struct Endings {
    at: BTreeSet<(Duration, Name, TierKey)>,
    of: BTreeMap<(Name, TierKey), Duration>,
}

impl Endings {
    fn set(&mut self, domain: Name, key: TierKey, ends: Option<Duration>) {
        let before = match ends {
            Some(ends) => self.of.insert((domain, key), ends),
            None => self.of.remove(&(domain, key)),
        };
        if let Some(before) = before {
            self.at.remove(&(before, domain, key));
        }
        if let Some(ends) = ends {
            self.at.insert((ends, domain, key));
        }
    }

    fn take_ended(&mut self, now: Duration) -> Option<(Name, TierKey)> {
        let (ends, domain, key) = self.at.first().copied().filter(|(ends, ..)| *ends <= now)?;
        self.at.remove(&(ends, domain, key));
        self.of.remove(&(domain, key));
        Some((domain, key))
    }
}

/// What the own domain says of itself.
impl Tiers {
    /// Of domain `home`. What it tells neighbours is of runs above `run`, one for each that comes: nanoseconds since any fixed time do, as
    /// they are ahead of whatever an earlier RIB has come to.
    pub fn new(home: Name, run: u64, limits: Limits) -> Self {
        Self {
            home,
            run,
            limits,
            parents: Vec::new(),
            adjacent: BTreeSet::new(),
            sides: BTreeMap::new(),
            own: Table::default(),
            known: Told::default(),
            changed_names: BTreeSet::new(),
            changed_writers: BTreeSet::new(),
            changed_locators: BTreeSet::new(),
            endings: Endings::default(),
            queries: Queries::default(),
            answers: Vec::new(),
            strangers: 0,
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

    /// What an entity has stated in this domain, verified by its RIB, with the membership of the switch it is attached to. Of what is for
    /// this domain alone nothing is kept.
    pub fn set_own(&mut self, now: Now, record: Record, host: Membership) -> Result<(), CertError> {
        let place = record.place()?;
        let scope = record.credential.scope()?;
        if record.is_writer() && scope.iter().all(|domain| *domain == self.home) {
            self.remove_own(place);
            return Ok(());
        }
        let ends = now.clock + Duration::from_secs(record.expires_in);
        let held = Held { place, record, host, path: Vec::new(), scope, ends };
        let key = TierKey::Part(place);
        if self.own.insert(key, Item::part(Arc::new(held))) {
            self.changed(key);
        }
        Ok(())
    }

    pub fn remove_own(&mut self, place: RecordPlace) {
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
    pub fn take_changes(&mut self, now: Now) -> Vec<Change> {
        self.spread();
        let everything = Room { entries: usize::MAX, bytes: usize::MAX };
        let Some(parcel) = self.known.feed.next(now.clock, everything, |_| 0) else { return Vec::new() };
        self.known.feed.answered(now.clock, parcel.generation, true);
        let removed = parcel.remove.into_iter().map(Change::Remove);
        removed.chain(parcel.set.into_iter().map(Change::Set)).collect()
    }

    /// What the own RIB may know of an entity of another domain, with the keys it has for readers here.
    pub fn known_of(&self, entity: Name) -> OfEntity {
        self.known.of(entity)
    }

    /// The part at a place that the own RIB may know, and whether it only passes through this domain.
    pub fn known_at(&self, place: &RecordPlace) -> Option<(Arc<Held>, bool)> {
        match self.known.feed.entries().get(&TierKey::Part(*place)) {
            Some(Item::Part { held, only_passes }) => Some((held.clone(), *only_passes)),
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
            standing: side.standing.clone(),
            entries_in: side.table.len(),
            entries_out: side.told.feed.entries().len(),
            refused: side.refused.clone(),
            lacking: side.lacking.clone(),
        })
    }

    /// Messages of domains that are neither parent nor child.
    pub fn strangers(&self) -> u64 {
        self.strangers
    }
}

/// What ends by itself.
impl Tiers {
    /// An owner of a name, or a domain, has taken something back: what rests on it goes.
    pub fn reconsider(&mut self, now: Now, about: Name, revoked: &impl Revoked) {
        let judge = Judge { home: self.home, now, revoked };
        let (mut gone, mut fewer) = (Vec::new(), Vec::new());
        for (domain, side) in &self.sides {
            if let Some(Item::Locator { locator, .. }) = side.table.get(&TierKey::Locator(about)) {
                let entry = TierEntry::Locator { domain: about, locator: (**locator).clone() };
                match judge.entry(*domain, &side.table, entry) {
                    Ok(judged) if judged.left_out.is_empty() => {}
                    Ok(judged) => fewer.push((*domain, judged)),
                    Err(refusal) => gone.push((*domain, TierKey::Locator(about), refusal)),
                }
            }
            for held in side.table.parts_about(about) {
                if let Err(refusal) = judge.still_holds(held) {
                    gone.push((*domain, TierKey::Part(held.place), refusal));
                }
            }
        }
        for (domain, key, refusal) in gone {
            self.count(domain, refusal.as_str());
            self.forget(domain, key);
        }
        for (domain, Judged { key, item, ends, left_out }) in fewer {
            let Some(side) = self.sides.get_mut(&domain) else { continue };
            left_out.iter().for_each(|refusal| side.count(refusal.as_str()));
            if side.table.insert(key, item) {
                self.endings.set(domain, key, Some(ends));
                self.changed(key);
            }
        }
    }

    pub fn tick(&mut self, now: Now) {
        while let Some((domain, key)) = self.endings.take_ended(now.clock) {
            self.forget(domain, key);
        }
        let mut gone = Vec::new();
        for (domain, side) in &mut self.sides {
            if side.kind == Kind::Child && now.clock >= side.heard + SILENCE {
                side.lose(now.clock);
            }
            if matches!(side.standing, Standing::Lost(since) if now.clock >= since + HOLD) {
                gone.push(*domain);
            }
        }
        for domain in gone {
            self.clear(domain);
            match self.sides.get_mut(&domain) {
                Some(side) if side.kind.is_parent() => {
                    side.standing = Standing::Waiting;
                    side.ancestors.clear();
                }
                _ => drop(self.sides.remove(&domain)),
            }
        }
        self.queries.expire(now.clock);
        for ticket in self.queries.overdue(now.clock) {
            if let Some(climbing) = self.queries.climbing.get_mut(&ticket) {
                (climbing.at, climbing.until) = (None, now.clock + PATIENCE);
            }
        }
    }

    /// When [`Self::effects`] has something to do, if nothing else happens before.
    pub fn next_tick(&self) -> Option<Duration> {
        let sides = self.sides.iter().flat_map(|(domain, side)| {
            let can_ask = self.adjacent.contains(domain) && !side.is_asked;
            let hello = (can_ask && side.kind.is_parent()).then_some(side.hello_at);
            let retry = side.told.feed.retry_at().filter(|_| can_ask && side.is_followed());
            let silence = (side.kind == Kind::Child && side.standing == Standing::Up).then(|| side.heard + SILENCE);
            let hold = match side.standing {
                Standing::Lost(since) => Some(since + HOLD),
                _ => None,
            };
            [hello, retry, silence, hold].into_iter().flatten()
        });
        sides.chain(self.endings.at.first().map(|(ends, ..)| *ends)).chain(self.queries.next_tick()).min()
    }

    /// Forgets all that a neighbour said.
    fn clear(&mut self, domain: Name) {
        let Some(side) = self.sides.get_mut(&domain) else { return };
        for key in std::mem::take(&mut side.table).keys() {
            self.endings.set(domain, *key, None);
            self.changed(*key);
        }
    }

    fn forget(&mut self, domain: Name, key: TierKey) {
        if self.sides.get_mut(&domain).is_some_and(|side| side.table.remove(&key).is_some()) {
            self.endings.set(domain, key, None);
            self.changed(key);
        }
    }

    fn changed(&mut self, key: TierKey) {
        match key {
            TierKey::Part(place) => {
                self.queries.heard_of(place.name);
                self.changed_names.insert(place.name);
            }
            TierKey::Box { writer, .. } => drop(self.changed_writers.insert(writer)),
            TierKey::Locator(domain) => drop(self.changed_locators.insert(domain)),
        }
    }

    /// A neighbour came or went, or is another than before.
    fn all_changed(&mut self) {
        let tables = self.sides.values().map(|side| &side.table).chain([&self.own]);
        let names = tables.flat_map(Table::parts).map(|held| held.place.name);
        self.changed_names.extend(names);
    }

    fn count(&mut self, of: Name, what: &'static str) {
        if let Some(side) = self.sides.get_mut(&of) {
            side.count(what);
        }
    }
}
