//! One neighbouring domain, as this RIB sees it: what it says, what it is to be told, and how the
//! two stand.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Bound::{Included, Unbounded};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::Signed;
use gdp_core::keys::KeyBox;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control::{RecordKey, TierHolds, TierKey};
use gdp_wire::Name;

use super::table::{Item, RecordTable, TableRecord, count_out, first_box, first_key, is_box_of};
use crate::feed::Feed;

/// How long what a neighbour said stays after it was heard last: a restart or a short partition
/// must not cost the names.
pub const RESTART_TIME: Duration = Duration::from_secs(30);

/// After so long a child that says nothing counts as lost.
pub const SILENCE: Duration = Duration::from_secs(15);

/// Between two hellos to a parent, and after one that failed.
pub const HELLO: Duration = Duration::from_secs(5);
pub const HELLO_AGAIN: Duration = Duration::from_secs(1);

/// Names of which one neighbour is told what was taken back.
pub const MAX_REVOKED_NAMES: usize = 1024;

/// What a neighbouring domain is to this one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// In the order in which parents are asked.
    Parent(usize),
    Child,
}

impl Kind {
    pub fn is_parent(self) -> bool {
        matches!(self, Self::Parent(_))
    }
}

/// How this domain and a neighbour stand.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum SessionState {
    /// Nothing has been heard of it.
    #[default]
    Waiting,
    Up,
    /// Since this time. What it said is kept for [`RESTART_TIME`].
    Lost(Duration),
    /// It would be above itself. Nothing is taken from it and nothing told to it before this time.
    Refused {
        until: Duration,
        reason: String,
    },
}

#[derive(Debug)]
pub struct Side {
    pub kind: Kind,
    pub session: SessionState,
    pub table: RecordTable,
    pub sent: SentUpdate,
    /// Of what is told: another number than that of any side before, whose generations the
    /// neighbour may still hold.
    pub run: u64,
    /// Of the neighbour's side that was heard last.
    peer_run: Option<u64>,
    pub last_seen: Duration,
    pub hello_at: Duration,
    /// A hello or a push is out; there is one at a time.
    pub is_asked: bool,
    /// How often in a row it said to hold something else than it was sent.
    drift: u8,
    /// Of a parent: the domains above it.
    pub ancestors: BTreeSet<Name>,
    /// How often it was refused for a cycle.
    pub cycles: u64,
    pub refused: BTreeMap<&'static str, u64>,
    /// Why it takes in only a part of what it is told.
    pub lacking: Option<String>,
}

impl Side {
    pub fn new(now: Duration, kind: Kind, run: u64) -> Self {
        Self {
            kind,
            session: SessionState::Waiting,
            table: RecordTable::default(),
            sent: SentUpdate::default(),
            run,
            peer_run: None,
            last_seen: now,
            hello_at: now,
            is_asked: false,
            drift: 0,
            ancestors: BTreeSet::new(),
            cycles: 0,
            refused: BTreeMap::new(),
            lacking: None,
        }
    }

    pub fn is_refused(&self) -> bool {
        matches!(self.session, SessionState::Refused { .. })
    }

    /// Whether it is told what changes: one that is refused, that it is told nothing any more.
    pub fn is_followed(&self) -> bool {
        matches!(self.session, SessionState::Up | SessionState::Refused { .. })
    }

    /// It said hello, and which of this side's pushes it holds. What it lacks it is sent.
    pub fn hello(&mut self, now: Duration, run: u64, holds: Option<TierHolds>) {
        self.last_seen = now;
        if !self.is_refused() {
            self.session = SessionState::Up;
        }
        let lacks = match self.sent.feed.acknowledged() {
            Some(generation) => holds != Some(TierHolds { run: self.run, generation }),
            None => false,
        };
        // Another answer may have overtaken this one, but not twice.
        self.drift = if lacks { self.drift + 1 } else { 0 };
        let is_new = self.peer_run.replace(run).is_some_and(|before| before != run);
        if is_new || (lacks && holds.is_none()) || self.drift > 1 {
            self.sent.feed.restart();
            self.drift = 0;
        }
    }

    /// It does not answer, or is not reached.
    pub fn lose(&mut self, now: Duration) {
        if self.session == SessionState::Up {
            self.session = SessionState::Lost(now);
        }
    }

    pub fn count(&mut self, what: &'static str) {
        *self.refused.entry(what).or_default() += 1;
    }
}

/// What is told of one entity.
pub struct OfEntity {
    /// Each with whether it only passes through this domain.
    pub parts: Vec<(Arc<TableRecord>, bool)>,
    pub boxes: Vec<Signed<KeyBox>>,
}

/// What one side is to be told, and by which sides it was said: this RIB's own entities are such a
/// side, too.
#[derive(Debug, Default)]
pub struct SentUpdate {
    pub feed: Feed<TierKey, Item>,
    /// Of each entity the parts that are told, and who said them.
    entities: BTreeMap<Name, BTreeMap<RecordKey, Name>>,
    /// Of each domain how many of the parts stated there were said by whom.
    origins: BTreeMap<Name, BTreeMap<Name, usize>>,
    /// The names of which it is told what was taken back, in the order in which that came.
    revoked: VecDeque<Name>,
}

impl SentUpdate {
    /// Makes these the parts in a name that are told. Returns the entities that had a part before,
    /// and the domains whose parts changed.
    pub fn replace_parts(&mut self, home: Name, name: Name, parts: Vec<Item>) -> (BTreeSet<Name>, BTreeSet<Name>) {
        let (mut entities, mut origins) = (BTreeSet::new(), BTreeSet::new());
        let parts: BTreeMap<TierKey, Item> = parts
            .into_iter()
            .filter_map(|item| match &item {
                Item::Part { record: held, .. } => Some((TierKey::Part(held.key), item)),
                _ => None,
            })
            .collect();
        let is_of_name = |key: &TierKey| matches!(key, TierKey::Part(place) if place.name == name);
        let before: Vec<(TierKey, Item)> = self
            .feed
            .entries()
            .range((Included(first_key(name)), Unbounded))
            .take_while(|(key, _)| is_of_name(key))
            .map(|(key, item)| (*key, item.clone()))
            .collect();
        for (key, old) in before {
            let Item::Part { record: held, .. } = &old else { continue };
            entities.insert(held.key.entity);
            if parts.get(&key) == Some(&old) {
                continue;
            }
            let (origin, via) = (held.origin(home), held.via(home));
            origins.insert(origin);
            if let Some(places) = self.entities.get_mut(&held.key.entity) {
                places.remove(&held.key);
                if places.is_empty() {
                    self.entities.remove(&held.key.entity);
                }
            }
            if let Some(said_by) = self.origins.get_mut(&origin) {
                count_out(said_by, &via);
                if said_by.is_empty() {
                    self.origins.remove(&origin);
                }
            }
            if !parts.contains_key(&key) {
                self.feed.set(key, None);
            }
        }
        for (key, item) in parts {
            let Item::Part { record: held, .. } = &item else { continue };
            if self.feed.entries().get(&key) != Some(&item) {
                let (origin, via) = (held.origin(home), held.via(home));
                origins.insert(origin);
                self.entities.entry(held.key.entity).or_default().insert(held.key, via);
                *self.origins.entry(origin).or_default().entry(via).or_default() += 1;
            }
            self.feed.set(key, Some(item));
        }
        (entities, origins)
    }

    /// Makes these the boxes of a writer that are told.
    pub fn replace_boxes(&mut self, writer: Name, boxes: BTreeMap<TierKey, Item>) {
        let held = self.feed.entries().range(first_box(writer)..).take_while(|(key, _)| is_box_of(key, writer));
        let gone: Vec<TierKey> = held.map(|(key, _)| *key).filter(|key| !boxes.contains_key(key)).collect();
        gone.into_iter().for_each(|key| self.feed.set(key, None));
        boxes.into_iter().for_each(|(key, item)| self.feed.set(key, Some(item)));
    }

    /// Whether a part in this name is told.
    pub fn tells_of(&self, name: Name) -> bool {
        let first = self.feed.entries().range(first_key(name)..).next();
        matches!(first, Some((TierKey::Part(place), _)) if place.name == name)
    }

    /// Tells what the owner of a name has taken back. Of too many such the first is told no more;
    /// whoever has heard it keeps it all the same.
    pub fn tell_revoked(&mut self, name: Name, kept: &SignedRevocation) {
        if !self.feed.entries().contains_key(&TierKey::Revocation(name)) {
            self.revoked.push_back(name);
        }
        self.feed.set(TierKey::Revocation(name), Some(Item::Revocation(Arc::new(kept.clone()))));
        if self.revoked.len() > MAX_REVOKED_NAMES
            && let Some(first) = self.revoked.pop_front()
        {
            self.feed.set(TierKey::Revocation(first), None);
        }
    }

    /// The parts of an entity that are told, and its boxes.
    pub fn of(&self, entity: Name) -> OfEntity {
        let places = self.entities.get(&entity).into_iter().flat_map(BTreeMap::keys);
        let parts = places.filter_map(|place| match self.feed.entries().get(&TierKey::Part(*place)) {
            Some(Item::Part { record: held, only_passes }) => Some((held.clone(), *only_passes)),
            _ => None,
        });
        let boxes = self.feed.entries().range(first_box(entity)..).take_while(|(key, _)| is_box_of(key, entity));
        let boxes = boxes.filter_map(|(_, item)| match item {
            Item::Box(signed) => Some((**signed).clone()),
            _ => None,
        });
        OfEntity { parts: parts.collect(), boxes: boxes.collect() }
    }

    /// Who said the parts of an entity that are told.
    pub fn said_of(&self, entity: &Name) -> BTreeSet<Name> {
        self.entities.get(entity).into_iter().flat_map(|places| places.values().copied()).collect()
    }

    /// Who said the parts that are told of a domain.
    pub fn said_from(&self, origin: &Name) -> impl Iterator<Item = Name> {
        self.origins.get(origin).into_iter().flat_map(|said_by| said_by.keys().copied())
    }

    /// The domains whose parts are told.
    pub fn origins(&self) -> impl Iterator<Item = &Name> {
        self.origins.keys()
    }
}
