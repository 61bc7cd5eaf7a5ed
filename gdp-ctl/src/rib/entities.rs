//! The entities a RIB knows: where they are attached, how far their serials are spent, which names they
//! have. An entity that is gone is remembered as long as one of its statements could still be presented again.

use std::collections::{BTreeSet, HashMap};
use std::time::Duration;

use gdp::control::Refusal;
use gdp_wire::Name;

use super::names::Key;
use super::{Timer, Timers, limit_reached};

#[derive(Debug)]
pub(super) struct Entity {
    pub floor: u64,
    pub attachment: Option<Attachment>,
    /// The latest end of a certificate that a statement of the entity was accepted under.
    pub remember_until: Duration,
    names: BTreeSet<Key>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Attachment {
    pub switch: Name,
    pub ends: Duration,
}

#[derive(Debug, Default)]
pub(super) struct Entities(HashMap<Name, Entity>);

static NO_NAMES: BTreeSet<Key> = BTreeSet::new();

impl Entities {
    pub fn get_or_insert(&mut self, name: Name, limit: usize, timers: &mut Timers) -> Result<&mut Entity, Refusal> {
        if self.0.len() >= limit && !self.0.contains_key(&name) {
            return Err(limit_reached(format!("{limit} entities are known")));
        }
        let entity = self.0.entry(name).or_insert_with(|| Entity {
            floor: 0,
            attachment: None,
            remember_until: Duration::ZERO,
            names: BTreeSet::new(),
        });
        timers.remove(&(entity.remember_until, Timer::Entity { entity: name }));
        Ok(entity)
    }

    pub fn floor(&self, name: &Name) -> u64 {
        self.0.get(name).map_or(0, |e| e.floor)
    }

    pub fn raise_floor(&mut self, name: &Name, serial: u64) {
        if let Some(entity) = self.0.get_mut(name) {
            entity.floor = serial;
        }
    }

    pub fn attachment(&self, name: &Name) -> Option<Attachment> {
        self.0.get(name)?.attachment
    }

    pub fn take_attachment(&mut self, name: &Name) -> Option<Attachment> {
        self.0.get_mut(name)?.attachment.take()
    }

    pub fn names(&self, name: &Name) -> &BTreeSet<Key> {
        self.0.get(name).map_or(&NO_NAMES, |e| &e.names)
    }

    pub fn add_name(&mut self, entity: &Name, name: Key) {
        if let Some(entity) = self.0.get_mut(entity) {
            entity.names.insert(name);
        }
    }

    pub fn remove_name(&mut self, entity: &Name, name: &Key) {
        if let Some(entity) = self.0.get_mut(entity) {
            entity.names.remove(name);
        }
    }

    /// Sees to it that an entity with neither an attachment nor a name is forgotten in time.
    pub fn retire(&mut self, name: &Name, timers: &mut Timers) {
        let Some(entity) = self.0.get(name) else { return };
        if entity.attachment.is_some() || !entity.names.is_empty() {
            return;
        }
        if entity.floor == 0 {
            self.0.remove(name);
        } else {
            timers.insert((entity.remember_until, Timer::Entity { entity: *name }));
        }
    }

    pub fn forget(&mut self, name: &Name) {
        if self.0.get(name).is_some_and(|e| e.attachment.is_none() && e.names.is_empty()) {
            self.0.remove(name);
        }
    }
}
