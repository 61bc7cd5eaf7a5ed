//! Session with one neighbouring domain: its announcements, what it is to be told, and the session
//! state.

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

/// Time for which a lost neighbour's announcements stay, as in graceful restart (RFC 4724). A
/// restart or a short partition must not cost the names.
pub const RESTART_TIME: Duration = Duration::from_secs(30);

/// Silence after which a child counts as lost.
pub const SILENCE: Duration = Duration::from_secs(15);

/// Interval between two hellos to a parent, and after a failed one.
pub const HELLO: Duration = Duration::from_secs(5);
pub const HELLO_AGAIN: Duration = Duration::from_secs(1);

/// Maximum number of names whose revocations one neighbour is told.
pub const MAX_REVOKED_NAMES: usize = 1024;

/// Relation of a neighbouring domain to this one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DomainRelation {
    /// Parent, with its position in the order of queries.
    Parent(usize),
    Child,
}

impl DomainRelation {
    pub fn is_parent(self) -> bool {
        matches!(self, Self::Parent(_))
    }
}

/// State of the session with a neighbour.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum SessionState {
    /// No message of the neighbour has arrived.
    #[default]
    Waiting,
    Up,
    /// The neighbour is lost since this time. Its announcements stay for [`RESTART_TIME`].
    Lost(Duration),
    /// The neighbour would become its own ancestor. Nothing is accepted from it or sent to it
    /// before this time.
    Refused {
        until: Duration,
        reason: String,
    },
}

#[derive(Debug)]
pub struct Side {
    pub kind: DomainRelation,
    pub session: SessionState,
    pub table: RecordTable,
    pub sent: SentUpdate,
    /// Run number of the pushes. It differs from that of every earlier session, whose generations
    /// the neighbour may still hold.
    pub run: u64,
    /// Run number of the neighbour's session, as received last.
    peer_run: Option<u64>,
    pub last_seen: Duration,
    pub hello_at: Duration,
    /// A hello or a push is in flight; there is at most one.
    pub is_asked: bool,
    /// Number of consecutive hellos that reported other holdings than those sent.
    drift: u8,
    /// Domains above a parent.
    pub ancestors: BTreeSet<Name>,
    /// Number of refusals for a cycle.
    pub cycles: u64,
    pub refused: BTreeMap<&'static str, u64>,
    /// Reason why the neighbour accepts only part of what it is sent.
    pub lacking: Option<String>,
}

impl Side {
    pub fn new(now: Duration, kind: DomainRelation, run: u64) -> Self {
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

    /// Returns whether changes are sent to the neighbour. A refused one is sent the removal of its
    /// entries.
    pub fn is_followed(&self) -> bool {
        matches!(self.session, SessionState::Up | SessionState::Refused { .. })
    }

    /// Processes a hello with the push that the neighbour holds. Restarts the feed if the neighbour
    /// is new or lacks entries.
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

    /// Marks the neighbour as lost: it does not answer or is unreachable.
    pub fn lose(&mut self, now: Duration) {
        if self.session == SessionState::Up {
            self.session = SessionState::Lost(now);
        }
    }

    pub fn count(&mut self, what: &'static str) {
        *self.refused.entry(what).or_default() += 1;
    }
}

/// What the own RIB may know of one entity.
pub struct OfEntity {
    /// Records, each with whether it only passes through this domain.
    pub parts: Vec<(Arc<TableRecord>, bool)>,
    pub boxes: Vec<Signed<KeyBox>>,
}

/// Entries that one side is to be told, and the sides that announced them. The own RIB is also such
/// a side.
#[derive(Debug, Default)]
pub struct SentUpdate {
    pub feed: Feed<TierKey, Item>,
    /// Sent records of each entity, with the domain that announced each.
    entities: BTreeMap<Name, BTreeMap<RecordKey, Name>>,
    /// Number of sent records by origin domain and by the domain that announced them.
    origins: BTreeMap<Name, BTreeMap<Name, usize>>,
    /// Names whose revocations are sent, in the order of arrival.
    revoked: VecDeque<Name>,
}

impl SentUpdate {
    /// Replaces the sent records of a name. Returns the entities that had records before, and the
    /// domains whose records changed.
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

    /// Replaces the sent key boxes of a writer.
    pub fn replace_boxes(&mut self, writer: Name, boxes: BTreeMap<TierKey, Item>) {
        let held = self.feed.entries().range(first_box(writer)..).take_while(|(key, _)| is_box_of(key, writer));
        let gone: Vec<TierKey> = held.map(|(key, _)| *key).filter(|key| !boxes.contains_key(key)).collect();
        gone.into_iter().for_each(|key| self.feed.set(key, None));
        boxes.into_iter().for_each(|(key, item)| self.feed.set(key, Some(item)));
    }

    /// Returns whether any record of this name is sent.
    pub fn tells_of(&self, name: Name) -> bool {
        let first = self.feed.entries().range(first_key(name)..).next();
        matches!(first, Some((TierKey::Part(place), _)) if place.name == name)
    }

    /// Sends the revocation of a name. Above [`MAX_REVOKED_NAMES`] the oldest one is no longer
    /// sent; neighbours that received it keep it.
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

    /// Returns the sent records and key boxes of an entity.
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

    /// Returns the domains that announced the sent records of an entity.
    pub fn said_of(&self, entity: &Name) -> BTreeSet<Name> {
        self.entities.get(entity).into_iter().flat_map(|places| places.values().copied()).collect()
    }

    /// Returns the domains that announced the sent records of an origin domain.
    pub fn said_from(&self, origin: &Name) -> impl Iterator<Item = Name> {
        self.origins.get(origin).into_iter().flat_map(|said_by| said_by.keys().copied())
    }

    /// Returns the origin domains of the sent records.
    pub fn origins(&self) -> impl Iterator<Item = &Name> {
        self.origins.keys()
    }
}
