//! Selects what each neighbour is told. Parents are told everything that may leave its domain.
//! Children and the own RIB are told the records of counterparts of their entities.
//!
//! Of several paths to a record, the shortest is used, and of equal ones that through the first
//! parent. No record is sent to a domain on its path, and no record from a parent is sent to a
//! parent, so that nothing loops.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use gdp_proto::control::{MAX_PATH, RecordKey, TierKey};
use gdp_wire::Name;

use super::interest::Interest;
use super::side::DomainRelation;
use super::table::{Item, TableRecord};
use super::{Tiers, side::Side};

impl Tiers {
    /// Recomputes what each side is told, for everything that has changed.
    pub(super) fn spread(&mut self) {
        let mut writers = std::mem::take(&mut self.changed_writers);
        let mut origins = std::mem::take(&mut self.changed_locators);
        for name in std::mem::take(&mut self.changed_names) {
            self.spread_name(name, &mut writers, &mut origins);
        }
        writers.into_iter().for_each(|writer| self.spread_boxes(writer));
        origins.into_iter().for_each(|origin| self.spread_locator(origin));
    }

    fn spread_name(&mut self, name: Name, writers: &mut BTreeSet<Name>, origins: &mut BTreeSet<Name>) {
        let home = self.home;
        let mut ways: BTreeMap<RecordKey, Vec<Arc<TableRecord>>> = BTreeMap::new();
        let interests: BTreeMap<Name, Interest> = {
            let sides = self.sides.iter().filter(|(_, side)| !side.is_refused());
            let tables = sides.map(|(domain, side)| (*domain, &side.table)).chain([(home, &self.own)]);
            let all = tables.map(|(domain, table)| (domain, Interest::of(home, table.parts_of(name))));
            all.filter(|(_, interest)| !interest.is_empty()).collect()
        };
        for held in self.own.parts_of(name) {
            ways.entry(held.key).or_default().push(held.clone());
        }
        for side in self.sides.values().filter(|side| !side.is_refused()) {
            for held in side.table.parts_of(name) {
                ways.entry(held.key).or_default().push(held.clone());
            }
        }
        for ways in ways.values_mut() {
            ways.sort_by_key(|held| (held.path.len(), self.rank(held.via(home))));
        }
        writers.extend(ways.keys().map(|place| place.entity));

        for (domain, side) in &mut self.sides {
            let is_from_above = |held: &TableRecord| self.parents.contains(&held.via(home));
            let interest = interests.get(domain);
            let is_fit = |held: &&Arc<TableRecord>| {
                held.path.len() < MAX_PATH
                    && !held.path.contains(domain)
                    && match side.kind {
                        DomainRelation::Parent(_) => held.may_leave(home) && !is_from_above(held),
                        DomainRelation::Child => interest.is_some_and(|interest| interest.wants(held, home)),
                    }
            };
            let is_told = !side.is_refused() && (side.kind.is_parent() || interest.is_some());
            let fit: Vec<Item> = match is_told {
                false => Vec::new(),
                true => ways.values().filter_map(|ways| ways.iter().find(is_fit).cloned()).map(Item::part).collect(),
            };
            let (entities, changed) = side.sent.replace_parts(home, name, fit);
            writers.extend(entities);
            origins.extend(changed);
        }

        let passes = |held: &&Arc<TableRecord>| {
            let others = interests.iter().filter(|(domain, _)| **domain != home && !held.path.contains(domain));
            others.map(|(_, interest)| interest).any(|interest| interest.wants(held, home))
        };
        let is_wanted =
            |held: &&Arc<TableRecord>| interests.get(&home).is_some_and(|interest| interest.wants(held, home));
        // Local records are known to the RIB already. Among remote paths, an unusable one must not
        // hide a usable one of another neighbour, however short it is.
        let abroad = ways.values().filter(|ways| ways.iter().all(|held| !held.path.is_empty()));
        let known = abroad.filter_map(|ways| {
            let wanted = ways.iter().find(is_wanted);
            let held = wanted.or_else(|| ways.iter().find(passes))?;
            Some(Item::Part { record: held.clone(), only_passes: wanted.is_none() })
        });
        let (entities, changed) = self.known.replace_parts(home, name, known.collect());
        writers.extend(entities);
        origins.extend(changed);
    }

    /// Sends the key boxes of a writer where its records and their readers are.
    fn spread_boxes(&mut self, writer: Name) {
        let mut desired: BTreeMap<Name, BTreeMap<TierKey, Item>> = BTreeMap::new();
        for domain in self.sides.keys().chain([&self.home]) {
            let (told, table) = match self.sides.get(domain) {
                Some(side) => (&side.sent, &side.table),
                None => (&self.known, &self.own),
            };
            let boxes = desired.entry(*domain).or_default();
            let mut said_by: Vec<Name> = told.said_of(&writer).into_iter().collect();
            said_by.sort_by_key(|via| self.rank(*via));
            for via in said_by {
                let own = (via == self.home).then_some(&self.own);
                let Some(source) = own.or_else(|| self.sides.get(&via).map(|side| &side.table)) else { continue };
                for (key, item) in source.boxes_of(writer) {
                    let TierKey::Box { reader, .. } = key else { continue };
                    if table.has_entity(reader) {
                        boxes.entry(*key).or_insert_with(|| item.clone());
                    }
                }
            }
        }
        for (domain, boxes) in desired {
            let told = self.sides.get_mut(&domain).map_or(&mut self.known, |side| &mut side.sent);
            told.replace_boxes(writer, boxes);
        }
    }

    /// Sends the locator of a domain where its records are sent.
    fn spread_locator(&mut self, origin: Name) {
        let key = TierKey::Locator(origin);
        let find = |side: Option<&Side>| {
            let told = side.map_or(&self.known, |side| &side.sent);
            let mut said_by: Vec<Name> = told.said_from(&origin).collect();
            said_by.sort_by_key(|via| self.rank(*via));
            said_by.into_iter().find_map(|via| match self.sides.get(&via) {
                Some(side) => side.table.get(&key).cloned(),
                None => self.own.get(&key).cloned(),
            })
        };
        let known = find(None);
        let found: Vec<_> = self.sides.iter().map(|(domain, side)| (*domain, find(Some(side)))).collect();
        self.known.feed.set(key, known);
        for (domain, item) in found {
            if let Some(side) = self.sides.get_mut(&domain) {
                side.sent.feed.set(key, item);
            }
        }
    }

    /// Returns the preference of a domain's announcements: this domain first, then parents in
    /// order, then children.
    fn rank(&self, via: Name) -> (usize, Name) {
        match self.parents.iter().position(|parent| *parent == via) {
            _ if via == self.home => (0, via),
            Some(index) => (1 + index, via),
            None => (usize::MAX, via),
        }
    }
}
