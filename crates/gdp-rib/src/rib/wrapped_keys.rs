//! Key boxes: the content keys of writers, each wrapped for one reader. The RIB stores them beside
//! the writer's advertisement, so that a new reader needs no round trip to the writer. Only the
//! reader can open a box, and it verifies the writer's signature again.

use std::collections::{BTreeMap, HashMap};
use std::ops::Bound;

use gdp_core::cert::Signed;
use gdp_core::keys::KeyBox;
use gdp_proto::control::{NameRole, Refusal, RefusalCode};
use gdp_wire::Name;

use super::journal::{Item, Journal};
use crate::rib::model::{At, InboxOwner, Limits, NameBytes, RegistrationKey, count_out, limit_reached};

/// Number of key epochs stored per writer and name: the present one and the one before.
const EPOCHS: usize = 2;

/// Bytes that a message adds to each encoded box.
const BOX_OVERHEAD: usize = 4;

#[derive(Debug)]
struct StoredKeys {
    /// Location of the writer when it stored its first box.
    at: At,
    /// Boxes by epoch, at most [`EPOCHS`], and reader.
    epochs: BTreeMap<u32, BTreeMap<Name, Signed<KeyBox>>>,
}

#[derive(Debug, Default)]
pub(super) struct WrappedKeyStore {
    /// Boxes by name and writer.
    stored: BTreeMap<(NameBytes, Name), StoredKeys>,
    by_writer: HashMap<Name, usize>,
    by_switch: HashMap<At, usize>,
    journal: Journal,
}

impl WrappedKeyStore {
    /// Returns whether this very box is already stored.
    pub fn holds(&self, claims: &KeyBox, signed: &Signed<KeyBox>) -> bool {
        let kept = self.stored.get(&(claims.name.to_bytes(), claims.writer));
        let readers = kept.and_then(|kept| kept.epochs.get(&claims.epoch));
        readers.and_then(|readers| readers.get(&claims.reader)).is_some_and(|held| held == signed)
    }

    /// Stores a verified box of the writer at `place`, and drops epochs that are too old.
    pub fn put(
        &mut self,
        place: InboxOwner,
        claims: &KeyBox,
        signed: Signed<KeyBox>,
        limits: &Limits,
    ) -> Result<(), Refusal> {
        let KeyBox { name, writer, reader, epoch, .. } = claims;
        let key = (name.to_bytes(), *writer);
        let epochs = self.stored.get(&key).map(|kept| &kept.epochs);
        let oldest = epochs.filter(|epochs| epochs.len() == EPOCHS && !epochs.contains_key(epoch));
        let oldest = oldest.and_then(|epochs| epochs.keys().next().copied());
        if let Some(oldest) = oldest.filter(|oldest| epoch < oldest) {
            let reason =
                format!("a key box of epoch {epoch} of {writer} for {name} is too old: {oldest} is the oldest kept");
            return Err(Refusal::new(RefusalCode::ReplayedSerial, reason));
        }
        let readers = epochs.and_then(|epochs| epochs.get(epoch));
        if !readers.is_some_and(|readers| readers.contains_key(reader)) {
            let going = oldest.and_then(|oldest| epochs?.get(&oldest)).map_or(0, BTreeMap::len);
            let beside = |count: Option<&usize>| count.map_or(0, |count| count.saturating_sub(going));
            for (what, held, limit) in [
                ("readers of an epoch", readers.map_or(0, BTreeMap::len), limits.box_readers),
                ("key boxes", beside(self.by_writer.get(writer)), limits.boxes_per_entity),
                (
                    "key boxes of all at its switch, or of its domain,",
                    beside(self.by_switch.get(&place.at)),
                    limits.boxes_per_switch,
                ),
            ] {
                if held >= limit {
                    return Err(limit_reached(format!("{limit} {what} are kept for {writer}")));
                }
            }
        }
        let new = || StoredKeys { at: place.at, epochs: BTreeMap::new() };
        let kept = self.stored.entry(key).or_insert_with(new);
        let at = kept.at;
        let gone = oldest.and_then(|oldest| Some((oldest, kept.epochs.remove(&oldest)?)));
        let is_new = kept.epochs.entry(*epoch).or_default().insert(*reader, signed).is_none();
        if is_new {
            *self.by_writer.entry(*writer).or_default() += 1;
            *self.by_switch.entry(at).or_default() += 1;
        }
        if is_stored(&at) {
            self.journal.mark(Item::KeyBox { name: *name, writer: *writer, epoch: *epoch, reader: *reader });
        }
        if let Some((epoch, readers)) = gone {
            self.mark(&key, &at, epoch, &readers);
            self.count_out(writer, &at, readers.len());
        }
        Ok(())
    }

    /// Removes all boxes of a writer that no longer sends to this name.
    pub fn forget(&mut self, name: &NameBytes, writer: &Name) {
        if let Some(kept) = self.stored.remove(&(*name, *writer)) {
            kept.epochs.iter().for_each(|(epoch, readers)| self.mark(&(*name, *writer), &kept.at, *epoch, readers));
            let count = kept.epochs.values().map(BTreeMap::len).sum();
            self.count_out(writer, &kept.at, count);
        }
    }

    /// Returns the boxes of a counterpart for the entity, if the entity subscribes to the name.
    pub fn between(
        &self,
        registration_key: &RegistrationKey,
        counterpart: &Name,
    ) -> impl Iterator<Item = &Signed<KeyBox>> {
        let kept = self
            .stored
            .get(&(registration_key.name, *counterpart))
            .filter(|_| registration_key.role == NameRole::Subscriber);
        let reader = registration_key.entity;
        kept.into_iter().flat_map(|kept| kept.epochs.values()).filter_map(move |readers| readers.get(&reader))
    }

    /// Returns all boxes of a writer for the readers of a name, with the readers.
    pub fn of(&self, name: &NameBytes, writer: &Name) -> impl Iterator<Item = (&Name, &Signed<KeyBox>)> {
        self.stored.get(&(*name, *writer)).into_iter().flat_map(|kept| kept.epochs.values()).flatten()
    }

    /// Returns the writers after `after` that have boxes for a name.
    pub fn writers(&self, name: &NameBytes, after: Option<Name>) -> impl Iterator<Item = Name> {
        let first = after.map_or(Bound::Included((*name, Name::default())), |after| Bound::Excluded((*name, after)));
        self.stored
            .range((first, Bound::Unbounded))
            .take_while(move |((of, _), _)| of == name)
            .map(|((_, writer), _)| *writer)
    }

    /// Returns the bytes of the boxes of [`Self::between`] in a message.
    pub fn size(&self, registration_key: &RegistrationKey, counterpart: &Name) -> usize {
        self.between(registration_key, counterpart).map(|signed| signed.as_bytes().len() + BOX_OVERHEAD).sum()
    }

    pub fn get(&self, name: &NameBytes, writer: &Name, epoch: u32, reader: &Name) -> Option<&Signed<KeyBox>> {
        self.stored.get(&(*name, *writer))?.epochs.get(&epoch)?.get(reader)
    }

    pub fn journal(&mut self) -> &mut Journal {
        &mut self.journal
    }

    fn mark(
        &mut self,
        (name, writer): &(NameBytes, Name),
        at: &At,
        epoch: u32,
        readers: &BTreeMap<Name, Signed<KeyBox>>,
    ) {
        if !is_stored(at) {
            return;
        }
        let name = Name::from_bytes(*name);
        let each = readers.keys().map(|reader| Item::KeyBox { name, writer: *writer, epoch, reader: *reader });
        each.for_each(|item| self.journal.mark(item));
    }

    fn count_out(&mut self, writer: &Name, at: &At, count: usize) {
        count_out(&mut self.by_writer, writer, count);
        count_out(&mut self.by_switch, at, count);
    }
}

/// Returns whether the store keeps the writer's boxes. RIBs of other domains announce those of
/// their entities again.
fn is_stored(at: &At) -> bool {
    matches!(at, At::Here(_))
}
