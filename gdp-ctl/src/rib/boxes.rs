//! Key boxes: the content keys of writers, each wrapped for one reader. Kept beside the writer's advertisement, so that it need
//! not be asked when a reader comes; only the reader can open them, and it verifies again who wrapped them.

use std::collections::{BTreeMap, HashMap};
use std::ops::Bound;

use gdp::cert::Signed;
use gdp::control::{NameRole, Refusal, RefusalCode};
use gdp::keys::KeyBox;
use gdp_wire::Name;

use super::inboxes::Place;
use super::names::Key;
use super::telling::Stake;
use super::{Limits, count_out, limit_reached};

/// Epochs of one writer and name that are kept: the present one and the one before.
const EPOCHS: usize = 2;

/// What an encoded box has in a message besides itself.
const BOX_OVERHEAD: usize = 4;

#[derive(Debug)]
struct Kept {
    switch: Name,
    /// By epoch, at most [`EPOCHS`], and reader.
    epochs: BTreeMap<u32, BTreeMap<Name, Signed<KeyBox>>>,
}

#[derive(Debug, Default)]
pub(super) struct Boxes {
    /// By name and writer.
    kept: BTreeMap<(Key, Name), Kept>,
    by_writer: HashMap<Name, usize>,
    by_switch: HashMap<Name, usize>,
}

impl Boxes {
    /// Whether just this is kept already.
    pub fn holds(&self, claims: &KeyBox, signed: &Signed<KeyBox>) -> bool {
        let kept = self.kept.get(&(claims.name.to_bytes(), claims.writer));
        let readers = kept.and_then(|kept| kept.epochs.get(&claims.epoch));
        readers.and_then(|readers| readers.get(&claims.reader)).is_some_and(|held| held == signed)
    }

    /// Keeps a verified box of the writer at `place`, and lets go of epochs that are too old.
    pub fn put(
        &mut self,
        place: Place,
        claims: &KeyBox,
        signed: Signed<KeyBox>,
        limits: &Limits,
    ) -> Result<(), Refusal> {
        let KeyBox { name, writer, reader, epoch, .. } = claims;
        let key = (name.to_bytes(), *writer);
        let epochs = self.kept.get(&key).map(|kept| &kept.epochs);
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
            let held =
                |counts: &HashMap<Name, usize>, name| counts.get(name).map_or(0, |count| count.saturating_sub(going));
            for (what, held, limit) in [
                ("readers of an epoch", readers.map_or(0, BTreeMap::len), limits.box_readers),
                ("key boxes", held(&self.by_writer, writer), limits.boxes_per_entity),
                ("key boxes of all at its switch", held(&self.by_switch, &place.switch), limits.boxes_per_switch),
            ] {
                if held >= limit {
                    return Err(limit_reached(format!("{limit} {what} are kept for {writer}")));
                }
            }
        }
        let new = || Kept { switch: place.switch, epochs: BTreeMap::new() };
        let kept = self.kept.entry(key).or_insert_with(new);
        let switch = kept.switch;
        let gone = oldest.and_then(|oldest| kept.epochs.remove(&oldest)).map_or(0, |readers| readers.len());
        let is_new = kept.epochs.entry(*epoch).or_default().insert(*reader, signed).is_none();
        if is_new {
            *self.by_writer.entry(*writer).or_default() += 1;
            *self.by_switch.entry(switch).or_default() += 1;
        }
        self.count_out(writer, &switch, gone);
        Ok(())
    }

    /// The writer sends to this name no more.
    pub fn forget(&mut self, name: &Key, writer: &Name) {
        if let Some(kept) = self.kept.remove(&(*name, *writer)) {
            let count = kept.epochs.values().map(BTreeMap::len).sum();
            self.count_out(writer, &kept.switch, count);
        }
    }

    /// What a counterpart has for the entity: the keys of what it sends to the name, if the entity is to take that.
    pub fn between(&self, stake: &Stake, counterpart: &Name) -> impl Iterator<Item = &Signed<KeyBox>> {
        let kept = self.kept.get(&(stake.name, *counterpart)).filter(|_| stake.role == NameRole::Subscriber);
        let reader = stake.entity;
        kept.into_iter().flat_map(|kept| kept.epochs.values()).filter_map(move |readers| readers.get(&reader))
    }

    /// Those behind `after` that have boxes for what they send to a name.
    pub fn writers(&self, name: &Key, after: Option<Name>) -> impl Iterator<Item = Name> {
        let first = after.map_or(Bound::Included((*name, Name::default())), |after| Bound::Excluded((*name, after)));
        self.kept
            .range((first, Bound::Unbounded))
            .take_while(move |((of, _), _)| of == name)
            .map(|((_, writer), _)| *writer)
    }

    /// Bytes that [`Self::between`] takes in a message.
    pub fn size(&self, stake: &Stake, counterpart: &Name) -> usize {
        self.between(stake, counterpart).map(|signed| signed.as_bytes().len() + BOX_OVERHEAD).sum()
    }

    fn count_out(&mut self, writer: &Name, switch: &Name, count: usize) {
        count_out(&mut self.by_writer, writer, count);
        count_out(&mut self.by_switch, switch, count);
    }
}
