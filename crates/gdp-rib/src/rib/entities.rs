//! The entities a RIB knows: where they are attached, by which of their links, how far their
//! serials are spent, which names they have. One that has neither an attachment nor a name is
//! forgotten at once; what remains of all of those is one number.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::name::NameProof;
use gdp_proto::control::{Refusal, RefusalCode};
use gdp_wire::Name;

use super::journal::{Item, Journal};
use crate::rib::model::{NameBytes, Now, count_out, limit_reached};
use crate::rib::registration::EntityIdentity;

/// How far ahead of the RIB's clock a serial may be, read as Unix time in nanoseconds, if it does
/// not just count up: 2 days.
const SERIAL_AHEAD: u64 = 2 * 24 * 3600;

#[derive(Debug)]
pub(super) struct Entity {
    floor: u64,
    /// By lane.
    attachments: BTreeMap<u8, Attachment>,
    names: BTreeSet<NameBytes>,
    /// The switch through which it came to be known, or that it was attached to last.
    through: Name,
    /// As it showed itself last.
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
    /// Those without an attachment, that tools speak for: how many through each switch.
    unattached: HashMap<Name, usize>,
    /// The highest serial spent by any entity that is forgotten. It is the floor of all that are
    /// not known, so that what one of them stated cannot be presented again: memory is bounded,
    /// however many come and go.
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
    /// The serial that a statement of the entity must exceed.
    pub fn floor(&self, name: &Name) -> u64 {
        self.known.get(name).map_or(self.forgotten, |entity| entity.floor)
    }

    /// A verified statement is spent, whatever becomes of it: nobody may present it again. `limit`:
    /// of entities without an attachment through one switch.
    ///
    /// One stranger could otherwise end the serials of all by stating the highest there is, and
    /// being forgotten; so they may jump no further than the clock does, which leaves some to
    /// everybody.
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

    /// All its attachments, by lane.
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

    /// Follow with [`Self::retire`].
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

    /// An entity as it shows itself, to be shared by all that it states so.
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

/// What a RIB needs that stores entities, or takes them back.
impl Entities {
    pub fn journal(&mut self) -> &mut Journal {
        &mut self.journal
    }

    pub fn forgotten(&self) -> u64 {
        self.forgotten
    }

    /// How far the serials of an entity are spent, and the switch through which it is known.
    pub fn known(&self, name: &Name) -> Option<(u64, Name)> {
        self.known.get(name).map(|entity| (entity.floor, entity.through))
    }

    pub fn restore_forgotten(&mut self, now: Now, floor: u64) {
        self.forgotten = self.forgotten.max(floor.min(furthest(now)));
    }

    /// Has the serials of an entity spent so far at least; no further than a statement could spend
    /// them.
    pub fn restore(&mut self, now: Now, name: Name, floor: u64, through: Name) {
        let floor = floor.min(furthest(now));
        let entity = self.known.entry(name).or_insert_with(|| {
            *self.unattached.entry(through).or_default() += 1;
            Entity::new(0, through)
        });
        entity.floor = entity.floor.max(floor);
    }

    /// Forgets all that have neither an attachment nor a name.
    pub fn retire_unused(&mut self) {
        let names: Vec<Name> = self.known.keys().copied().collect();
        names.iter().for_each(|name| self.retire(name));
    }
}

/// The highest serial that need not be counted up to.
fn furthest(now: Now) -> u64 {
    now.unix.saturating_add(SERIAL_AHEAD).saturating_mul(1_000_000_000)
}
