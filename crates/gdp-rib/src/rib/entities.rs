//! Entities that the RIB knows: their attachments by lane, the floor of their serials and their
//! names. The RIB forgets an entity without attachment and name at once. All forgotten entities
//! leave one number: the highest serial of any of them.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::name::NameProof;
use gdp_proto::control::{Refusal, RefusalCode};
use gdp_wire::Name;

use super::journal::{Item, Journal};
use crate::rib::model::{NameBytes, Now, count_out, limit_reached};
use crate::rib::registration::EntityIdentity;

/// Maximum lead in seconds (2 days) of a serial over the RIB's clock, unless the serial just counts
/// up. The serial is read as Unix time in nanoseconds.
const SERIAL_AHEAD: u64 = 2 * 24 * 3600;

#[derive(Debug)]
pub(super) struct Entity {
    floor: u64,
    /// Attachments by lane.
    attachments: BTreeMap<u8, Attachment>,
    names: BTreeSet<NameBytes>,
    /// Switch through which the entity became known, or to which it was attached last.
    through: Name,
    /// Identity that the entity presented last.
    identity: Option<Arc<EntityIdentity>>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Attachment {
    pub switch: Name,
    pub ends: Duration,
}

#[derive(Debug, Default)]
pub(super) struct Entities {
    known: HashMap<Name, Entity>,
    /// Number of known entities without an attachment, by the switch through which they are known.
    unattached: HashMap<Name, usize>,
    /// Highest serial of any forgotten entity, which is the floor of all unknown entities. An old
    /// statement can thus not be replayed, and memory stays bounded however many entities come and
    /// go.
    forgotten: u64,
    journal: Journal,
}

impl Entity {
    fn new(floor: u64, through: Name) -> Self {
        Self { floor, attachments: BTreeMap::new(), names: BTreeSet::new(), through, identity: None }
    }
}

static NO_NAMES: BTreeSet<NameBytes> = BTreeSet::new();

impl Entities {
    /// Returns the serial that a statement of the entity must exceed.
    pub fn floor(&self, name: &Name) -> u64 {
        self.known.get(name).map_or(self.forgotten, |entity| entity.floor)
    }

    /// Spends the serial of a verified statement, so that nobody can replay it whatever its
    /// outcome. `limit` bounds the entities without an attachment through one switch.
    ///
    /// A serial may exceed the floor by more than 1 only up to 2 days ahead of the clock. Otherwise
    /// one entity could state the highest serial, be forgotten, and thereby exhaust the serials of
    /// all.
    pub fn spend(&mut self, now: Now, name: Name, through: Name, serial: u64, limit: usize) -> Result<(), Refusal> {
        let (floor, furthest) = (self.floor(&name), furthest(now));
        if serial > floor.saturating_add(1) && serial > furthest {
            let reason =
                format!("serial {serial} is too far above {floor}: count up from what the attachment answered");
            return Err(Refusal::new(RefusalCode::Malformed, reason));
        }
        self.journal.mark(Item::Entity(name));
        if let Some(entity) = self.known.get_mut(&name) {
            entity.floor = serial;
            return Ok(());
        }
        let unattached = self.unattached.entry(through).or_default();
        if *unattached >= limit {
            return Err(limit_reached(format!(
                "{limit} entities are known through switch {through} without being attached"
            )));
        }
        *unattached += 1;
        self.known.insert(name, Entity::new(serial, through));
        Ok(())
    }

    pub fn attachment(&self, name: &Name, lane: u8) -> Option<Attachment> {
        self.known.get(name)?.attachments.get(&lane).copied()
    }

    /// Returns all attachments of the entity, by lane.
    pub fn attachments(&self, name: &Name) -> impl Iterator<Item = (u8, Attachment)> {
        let known = self.known.get(name).into_iter();
        known.flat_map(|entity| entity.attachments.iter().map(|(lane, attachment)| (*lane, *attachment)))
    }

    pub fn is_attached_at(&self, name: &Name, switch: &Name) -> bool {
        self.attachments(name).any(|(_, attachment)| attachment.switch == *switch)
    }

    pub fn attach(&mut self, name: Name, lane: u8, attachment: Attachment) {
        self.journal.mark(Item::Entity(name));
        let (floor, through) = (self.forgotten, attachment.switch);
        if let Some(entity) = self.known.get(&name).filter(|entity| entity.attachments.is_empty()) {
            count_out(&mut self.unattached, &entity.through, 1);
        }
        let entity = self.known.entry(name).or_insert_with(|| Entity::new(floor, through));
        entity.attachments.insert(lane, attachment);
        entity.through = through;
    }

    /// Removes and returns an attachment. Call [`Self::retire`] afterwards.
    pub fn take_attachment(&mut self, name: &Name, lane: u8) -> Option<Attachment> {
        let entity = self.known.get_mut(name)?;
        let attachment = entity.attachments.remove(&lane)?;
        self.journal.mark(Item::Entity(*name));
        if entity.attachments.is_empty() {
            entity.through = attachment.switch;
            *self.unattached.entry(attachment.switch).or_default() += 1;
        }
        Some(attachment)
    }

    /// Returns the identity that an entity presents, shared by all its statements that present the
    /// same one.
    pub fn identity(&mut self, name: Name, proof: NameProof, box_key: [u8; 33]) -> Arc<EntityIdentity> {
        let shown = EntityIdentity { name, proof, box_key };
        let Some(entity) = self.known.get_mut(&name) else { return Arc::new(shown) };
        match &entity.identity {
            Some(identity) if **identity == shown => identity.clone(),
            _ => entity.identity.insert(Arc::new(shown)).clone(),
        }
    }

    pub fn names(&self, name: &Name) -> &BTreeSet<NameBytes> {
        self.known.get(name).map_or(&NO_NAMES, |entity| &entity.names)
    }

    pub fn add_name(&mut self, entity: &Name, name: NameBytes) {
        if let Some(entity) = self.known.get_mut(entity) {
            entity.names.insert(name);
        }
    }

    pub fn remove_name(&mut self, entity: &Name, name: &NameBytes) {
        if let Some(entity) = self.known.get_mut(entity) {
            entity.names.remove(name);
        }
    }

    /// Forgets an entity that has neither an attachment nor a name.
    pub fn retire(&mut self, name: &Name) {
        if self.known.get(name).is_some_and(|entity| entity.attachments.is_empty() && entity.names.is_empty())
            && let Some(entity) = self.known.remove(name)
        {
            self.journal.mark(Item::Entity(*name));
            if entity.floor > self.forgotten {
                self.forgotten = entity.floor;
                self.journal.mark(Item::Floor);
            }
            count_out(&mut self.unattached, &entity.through, 1);
        }
    }
}

/// Access for the store and for restoring from it.
impl Entities {
    pub fn journal(&mut self) -> &mut Journal {
        &mut self.journal
    }

    pub fn forgotten(&self) -> u64 {
        self.forgotten
    }

    /// Returns the serial floor of an entity and the switch through which it is known.
    pub fn known(&self, name: &Name) -> Option<(u64, Name)> {
        self.known.get(name).map(|entity| (entity.floor, entity.through))
    }

    pub fn restore_forgotten(&mut self, now: Now, floor: u64) {
        self.forgotten = self.forgotten.max(floor.min(furthest(now)));
    }

    /// Raises the serial floor of an entity to at least `floor`, bounded as [`Self::spend`] bounds
    /// it.
    pub fn restore(&mut self, now: Now, name: Name, floor: u64, through: Name) {
        let floor = floor.min(furthest(now));
        let entity = self.known.entry(name).or_insert_with(|| {
            *self.unattached.entry(through).or_default() += 1;
            Entity::new(0, through)
        });
        entity.floor = entity.floor.max(floor);
    }

    /// Forgets all entities that have neither an attachment nor a name.
    pub fn retire_unused(&mut self) {
        let names: Vec<Name> = self.known.keys().copied().collect();
        names.iter().for_each(|name| self.retire(name));
    }
}

/// Returns the highest serial that an entity may use without counting up to it.
fn furthest(now: Now) -> u64 {
    now.unix.saturating_add(SERIAL_AHEAD).saturating_mul(1_000_000_000)
}
