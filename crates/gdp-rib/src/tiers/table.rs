//! Table of the verified announcements of one side: records, key boxes, locators. A neighbour's
//! full transfer updates its table by mark and sweep, as a FIB push does at a switch.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::{Host, Locator, Signed};
use gdp_core::keys::KeyBox;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control::{Extent, NameRole, Record, RecordKey, RemoteRecord, TierEntry, TierHolds, TierKey};
use gdp_wire::Name;

use crate::tiers::limits::TierLimits;
use crate::tiers::refusal::TierRefusal;

/// Verified registration.
#[derive(Clone, Debug)]
pub struct TableRecord {
    pub key: RecordKey,
    pub record: Record,
    pub host: Arc<Hosted>,
    /// Domains that the record passed, the announcing one last. Empty for a registration in this
    /// domain.
    pub path: Vec<Name>,
    /// Domains in the certificate of a writer.
    pub scope: Vec<Name>,
    /// End of the registration on this RIB's clock.
    pub ends: Duration,
}

/// Verified switch, shared by all registrations there.
#[derive(Debug, PartialEq)]
pub struct Hosted {
    pub host: Host,
    /// Domain of the switch.
    pub domain: Name,
    /// End of the switch's membership in Unix seconds, unless the domain revokes it.
    pub not_after: u64,
}

impl TableRecord {
    /// Returns the domain in which the registration was made.
    pub fn origin(&self, home: Name) -> Name {
        self.path.first().copied().unwrap_or(home)
    }

    /// Returns the domain that announced the record.
    pub fn via(&self, home: Name) -> Name {
        self.path.last().copied().unwrap_or(home)
    }

    /// Returns whether `abroad` states the same apart from path and remaining time, and thus needs
    /// no new verification.
    pub fn states_the_same(&self, abroad: &RemoteRecord) -> bool {
        let (own, other) = (&self.record, &abroad.record);
        (own.proof, own.entity, own.switch) == (other.proof, other.entity, other.switch)
            && (&own.credential, &own.advert) == (&other.credential, &other.advert)
            && self.host.host == abroad.host
    }

    /// Returns whether other domains may know the record.
    pub fn may_leave(&self, home: Name) -> bool {
        let origin = self.origin(home);
        !self.key.role.is_writer() || self.scope.iter().any(|domain| *domain != origin)
    }

    /// Returns the record as a neighbour is sent it.
    pub fn to_remote(&self, now: Duration, home: Name) -> RemoteRecord {
        let record = Record { expires_in: self.ends.saturating_sub(now).as_secs(), ..self.record.clone() };
        let path = self.path.iter().copied().chain([home]).collect();
        RemoteRecord { record, host: self.host.host.clone(), path }
    }
}

/// Ignores the remaining time, because a renewal is a new statement.
impl PartialEq for TableRecord {
    fn eq(&self, other: &Self) -> bool {
        let Record { name: _, proof, entity, switch: _, credential, advert, expires_in: _ } = &self.record;
        let that = &other.record;
        self.key == other.key
            && (proof, entity, credential, advert) == (&that.proof, &that.entity, &that.credential, &that.advert)
            && (&self.host, &self.path) == (&other.host, &other.path)
    }
}

/// Announced entry, shared by all tables that hold it.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// `only_passes` states that no entity of this domain may know the record. It still takes part
    /// in routes through this domain.
    Part {
        record: Arc<TableRecord>,
        only_passes: bool,
    },
    Box(Arc<Signed<KeyBox>>),
    Locator {
        domain: Name,
        locator: Arc<Locator>,
    },
    /// Only sent. Received revocations go to the RIB, which stores them.
    Revocation(Arc<SignedRevocation>),
}

impl Item {
    pub fn part(held: Arc<TableRecord>) -> Self {
        Self::Part { record: held, only_passes: false }
    }

    pub fn to_entry(&self, now: Duration, home: Name) -> TierEntry {
        match self {
            Self::Part { record: held, .. } => TierEntry::Part(Box::new(held.to_remote(now, home))),
            Self::Box(signed) => TierEntry::Box((**signed).clone()),
            Self::Locator { domain, locator } => TierEntry::Locator { domain: *domain, locator: (**locator).clone() },
            Self::Revocation(kept) => TierEntry::Revocation { proof: kept.proof, revocation: kept.revocation.clone() },
        }
    }

    /// Returns the approximate size in bytes, in a message and in memory.
    pub fn size(&self) -> usize {
        match self {
            Self::Part { record: held, .. } => {
                let TableRecord { record, host, path, .. } = &**held;
                PART_OVERHEAD
                    + record.credential.size()
                    + record.advert.as_bytes().len()
                    + host.host.size()
                    + (path.len() + 1) * NAME_SIZE
            }
            Self::Box(signed) => BOX_OVERHEAD + signed.as_bytes().len(),
            Self::Revocation(kept) => REVOCATION_OVERHEAD + kept.revocation.as_bytes().len(),
            Self::Locator { locator, .. } => PART_OVERHEAD * locator.borders.len().max(1) + locator.size(),
        }
    }
}

/// Bytes of an encoded record besides its signed parts: proofs, names, field names.
const PART_OVERHEAD: usize = 640;
const NAME_SIZE: usize = 34;
const BOX_OVERHEAD: usize = 32;
/// Bytes of a proof and field names.
const REVOCATION_OVERHEAD: usize = 160;

/// Index of records by an attribute that many share.
#[derive(Debug, Default)]
struct RecordIndex(BTreeMap<Name, BTreeSet<RecordKey>>);

impl RecordIndex {
    fn insert(&mut self, of: Name, place: RecordKey) {
        self.0.entry(of).or_default().insert(place);
    }

    fn remove(&mut self, of: &Name, place: &RecordKey) {
        let Some(places) = self.0.get_mut(of) else { return };
        places.remove(place);
        if places.is_empty() {
            self.0.remove(of);
        }
    }

    fn of(&self, of: Name) -> impl Iterator<Item = &RecordKey> {
        self.0.get(&of).into_iter().flatten()
    }
}

#[derive(Debug, Default)]
pub struct RecordTable {
    items: BTreeMap<TierKey, Item>,
    entities: RecordIndex,
    /// Records by origin domain, if it is another one.
    origins: RecordIndex,
    /// Switches of the records as last announced, each with its number of records.
    hosts: BTreeMap<Name, (Arc<Hosted>, usize)>,
    /// Number of records of each name, separately for writers (`true`) and readers.
    names: BTreeMap<(Name, bool), usize>,
    bytes: usize,
    /// Last processed push.
    holds: Option<TierHolds>,
    /// Full transfer in progress: the number of the next part, and the keys that no part has named
    /// yet.
    whole: Option<(u32, BTreeSet<TierKey>)>,
}

impl RecordTable {
    pub fn len(&self) -> usize {
        self.items.len()
    }

    pub fn holds(&self) -> Option<TierHolds> {
        self.holds
    }

    /// Returns whether a push is the next one to process, and if so, starts processing it.
    pub fn begin(&mut self, push: TierHolds, extent: Extent) -> bool {
        let follows = self
            .holds
            .is_some_and(|held| held.run == push.run && held.generation.checked_add(1) == Some(push.generation));
        let is_replayed = self.holds.is_some_and(|held| held.run == push.run && held.generation >= push.generation);
        match (extent, &self.whole) {
            (Extent::Full { part: 0, .. }, _) if !is_replayed => {
                self.whole = Some((1, self.items.keys().copied().collect()));
            }
            (Extent::Full { part, .. }, Some((next, _))) if follows && part == *next => {
                self.whole.as_mut().expect("it was looked at above").0 += 1;
            }
            (Extent::Delta, None) if follows => {}
            _ => return false,
        }
        self.holds = Some(push);
        true
    }

    /// Finishes a push. After the last part of a full transfer, returns the keys that no part
    /// named.
    pub fn end(&mut self, extent: Extent) -> BTreeSet<TierKey> {
        match extent {
            Extent::Full { last: true, .. } => self.whole.take().map_or_else(BTreeSet::new, |(_, unnamed)| unnamed),
            _ => BTreeSet::new(),
        }
    }

    pub fn get(&self, key: &TierKey) -> Option<&Item> {
        self.items.get(key)
    }

    /// Checks that the limits have room for an entry, which replaces the earlier one with this key.
    pub fn check_room(&self, key: &TierKey, item: &Item, limits: &TierLimits) -> Result<(), TierRefusal> {
        let before = self.items.get(key);
        let entries = self.items.len() + usize::from(before.is_none());
        let bytes = self.bytes - before.map_or(0, Item::size) + item.size();
        let needed = [("entries", entries, limits.entries), ("bytes", bytes, limits.bytes)];
        if let Some((what, _, limit)) = needed.into_iter().find(|(_, needed, limit)| needed > limit) {
            return Err(TierRefusal::Full { what, limit });
        }
        match key {
            TierKey::Part(RecordKey { name, role, .. })
                if before.is_none()
                    && self
                        .names
                        .get(&(*name, role.is_writer()))
                        .is_some_and(|parts| *parts >= limits.parts_per_name) =>
            {
                Err(TierRefusal::NameFull { name: *name, limit: limits.parts_per_name })
            }
            _ => Ok(()),
        }
    }

    /// Inserts an entry. Returns whether it differs from the earlier one.
    pub fn insert(&mut self, key: TierKey, item: Item) -> bool {
        if let Some((_, unnamed)) = &mut self.whole {
            unnamed.remove(&key);
        }
        let before = self.remove(&key);
        let changed = before.as_ref() != Some(&item);
        if let (TierKey::Part(place), Item::Part { record: held, .. }) = (key, &item) {
            self.entities.insert(place.entity, place);
            held.path.first().into_iter().for_each(|origin| self.origins.insert(*origin, place));
            *self.names.entry((place.name, place.role.is_writer())).or_default() += 1;
            let (host, parts) = self.hosts.entry(place.switch).or_insert_with(|| (held.host.clone(), 0));
            *parts += 1;
            host.clone_from(&held.host);
        }
        self.bytes += item.size();
        self.items.insert(key, item);
        changed
    }

    pub fn remove(&mut self, key: &TierKey) -> Option<Item> {
        let old = self.items.remove(key)?;
        self.bytes -= old.size();
        if let (TierKey::Part(place), Item::Part { record: held, .. }) = (key, &old) {
            self.entities.remove(&place.entity, place);
            held.path.first().into_iter().for_each(|origin| self.origins.remove(origin, place));
            count_out(&mut self.names, &(place.name, place.role.is_writer()));
            if let Some((_, parts)) = self.hosts.get_mut(&place.switch) {
                *parts -= 1;
                if *parts == 0 {
                    self.hosts.remove(&place.switch);
                }
            }
        }
        Some(old)
    }

    pub fn keys(&self) -> impl Iterator<Item = &TierKey> {
        self.items.keys()
    }

    /// Returns the records that a revocation by this name's owner, or by this domain, may concern.
    pub fn parts_about(&self, about: Name) -> impl Iterator<Item = &Arc<TableRecord>> {
        let stated_there = self.origins.of(about).filter_map(|place| self.part_at(place));
        self.parts_of(about).chain(stated_there)
    }

    /// Returns all records in the order of their keys.
    pub fn parts(&self) -> impl Iterator<Item = &Arc<TableRecord>> {
        self.items.values().map_while(|item| if let Item::Part { record: held, .. } = item { Some(held) } else { None })
    }

    /// Returns the records of one name.
    pub fn parts_of(&self, name: Name) -> impl Iterator<Item = &Arc<TableRecord>> {
        self.items.range(first_key(name)..).map_while(move |(key, item)| match (key, item) {
            (TierKey::Part(place), Item::Part { record: held, .. }) if place.name == name => Some(held),
            _ => None,
        })
    }

    /// Returns the key boxes of one writer.
    pub fn boxes_of(&self, writer: Name) -> impl Iterator<Item = (&TierKey, &Item)> {
        self.items.range(first_box(writer)..).take_while(move |(key, _)| is_box_of(key, writer))
    }

    /// Returns a switch as last announced, if it has records.
    pub fn host(&self, switch: &Name) -> Option<&Arc<Hosted>> {
        self.hosts.get(switch).map(|(host, _)| host)
    }

    /// Returns any record of an entity.
    pub fn part_by(&self, entity: &Name) -> Option<&Arc<TableRecord>> {
        self.part_at(self.entities.of(*entity).next()?)
    }

    fn part_at(&self, place: &RecordKey) -> Option<&Arc<TableRecord>> {
        match self.items.get(&TierKey::Part(*place)) {
            Some(Item::Part { record: held, .. }) => Some(held),
            _ => None,
        }
    }

    pub fn has_entity(&self, entity: &Name) -> bool {
        self.entities.of(*entity).next().is_some()
    }
}

/// Decrements a counter and removes it at zero.
pub fn count_out<K: Ord>(counts: &mut BTreeMap<K, usize>, of: &K) {
    if let Some(count) = counts.get_mut(of) {
        *count -= 1;
        if *count == 0 {
            counts.remove(of);
        }
    }
}

/// Returns the key where the records of a name begin.
pub fn first_key(name: Name) -> TierKey {
    let nobody = Name::default();
    TierKey::Part(RecordKey { name, role: NameRole::Publisher, entity: nobody, switch: nobody })
}

/// Returns the key where the boxes of a writer begin.
pub fn first_box(writer: Name) -> TierKey {
    TierKey::Box { writer, reader: Name::default(), name: Name::default(), epoch: 0 }
}

pub fn is_box_of(key: &TierKey, of: Name) -> bool {
    matches!(key, TierKey::Box { writer, .. } if *writer == of)
}
