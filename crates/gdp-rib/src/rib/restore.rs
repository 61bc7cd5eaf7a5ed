//! Encodes the RIB's items for a store and restores them in a later RIB. The later RIB verifies all
//! of it as if a stranger stated it now, within the limits for statements. Attachments, spent
//! serials and egress bits cannot be proven. They have no more effect than a switch's own report,
//! and end unless the switch confirms them.

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_core::cert::{CertError, Requester, Signed};
use gdp_core::keys::KeyBox;
use gdp_core::name::NameProof;
use gdp_core::peer::MAX_LANES;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control::{NameRole, Record, RecordKey, Refusal};
use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::entities::Attachment;
use super::journal::{Item, Journal};
use super::{Rib, Timer};
use crate::rib::model::{Now, RegistrationKey};
use crate::rib::registration::{Registration, shared};

/// Maximum bytes of one stored item. Records travel in messages of at most this size.
pub const MAX_ITEM: usize = 64 * 1024;

/// Version of the encoding. An item is encoded as an array of this and the value.
const VERSION: u8 = 1;

/// Reason why a stored item is skipped.
#[derive(Debug, thiserror::Error)]
pub enum RestoreError {
    #[error(transparent)]
    Malformed(#[from] CborError),
    #[error("written by version {0} of the store, which this release does not know")]
    Version(u8),
    #[error("it is stored under the key of another")]
    Misplaced,
    #[error(transparent)]
    NotProven(#[from] CertError),
    #[error("{0}")]
    Refused(#[from] Refusal),
    #[error("its time is over")]
    Over,
    #[error("what it is bound to is gone")]
    Unbound,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredEntity {
    floor: u64,
    /// Switch through which the entity is known.
    through: Name,
    attachments: Vec<StoredAttachment>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredAttachment {
    lane: u8,
    switch: Name,
    /// End of the attachment in Unix seconds.
    ends: u64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredRegistration {
    record: Record,
    /// End of the registration in Unix seconds.
    ends: u64,
    everywhere: bool,
    bound: bool,
}

/// Encodes a stored item of at most [`MAX_ITEM`] bytes.
pub fn encode_item<T: Serialize>(value: &T) -> Result<Vec<u8>, CborError> {
    let bytes = cbor::encode(&(VERSION, value))?;
    if bytes.len() > MAX_ITEM {
        return Err(CborError::TooLong { got: bytes.len(), max: MAX_ITEM });
    }
    Ok(bytes)
}

/// Decodes an item that [`encode_item`] encoded.
pub fn decode_item<T: DeserializeOwned + Serialize>(bytes: &[u8]) -> Result<T, RestoreError> {
    // Another version may have another shape.
    match bytes.get(..2) {
        Some([0x82, VERSION]) | None => {}
        Some([_, version]) => return Err(RestoreError::Version(*version)),
        Some(_) => {}
    }
    let (_, value): (u8, T) = cbor::decode(bytes, MAX_ITEM)?;
    Ok(value)
}

impl Rib {
    /// Starts to record changed items for [`Self::take_changed`].
    pub fn open_journal(&mut self) {
        self.journals().into_iter().for_each(Journal::open);
    }

    /// Returns the items that have changed, or may have, since the last call.
    pub fn take_changed(&mut self) -> BTreeSet<Item> {
        let mut changed = BTreeSet::new();
        self.journals().into_iter().for_each(|journal| journal.drain(&mut changed));
        changed
    }

    /// Returns whether [`Self::take_changed`] has items.
    pub fn has_changed(&mut self) -> bool {
        self.journals().iter().any(|journal| !journal.is_empty())
    }

    fn journals(&mut self) -> [&mut Journal; 5] {
        [
            &mut self.journal,
            self.bits.journal(),
            self.entities.journal(),
            self.boxes.journal(),
            self.revocations.journal(),
        ]
    }

    /// Returns the encoded state of an item, or `None` if it does not exist (any more).
    pub fn stored(&self, now: Now, item: &Item) -> Option<Vec<u8>> {
        let unix = |ends: Duration| now.unix.saturating_add(ends.saturating_sub(now.clock).as_secs());
        let encoded = match item {
            Item::Floor => encode_item(&self.entities.forgotten()),
            Item::Switch(switch) => encode_item(&self.bits.of(switch).filter(|_| self.switches.contains_key(switch))?),
            Item::Revocation(name) => encode_item(&self.revocations.get(name.as_bytes())?.signed),
            Item::Invitation(_) => return None,
            Item::Entity(entity) => {
                let (floor, through) = self.entities.known(entity)?;
                let stored = |(lane, Attachment { switch, ends })| StoredAttachment { lane, switch, ends: unix(ends) };
                let attachments: Vec<_> = self.entities.attachments(entity).map(stored).collect();
                // Restoring sets the same value. For an attached entity the field has no other
                // meaning.
                let through = attachments.last().map_or(through, |attachment| attachment.switch);
                encode_item(&StoredEntity { floor, through, attachments })
            }
            Item::Registration(RecordKey { name, role, entity, switch }) => {
                let proof = self.names.proof(name.as_bytes())?;
                let registration = self.names.get_at(name.as_bytes(), entity, *role, switch)?;
                let Registration { ends, everywhere, bound, .. } = *registration;
                let record = Record { expires_in: 0, ..registration.record(now.clock, *name, proof) };
                encode_item(&StoredRegistration { record, ends: unix(ends), everywhere, bound })
            }
            Item::KeyBox { name, writer, epoch, reader } => {
                encode_item(self.boxes.get(name.as_bytes(), writer, *epoch, reader)?)
            }
        };
        encoded.inspect_err(|error| tracing::error!(%item, %error, "cannot be stored")).ok()
    }

    /// Restores one item of an earlier RIB of this domain. Call it in the order of the items, then
    /// [`Self::restored`].
    pub fn restore(&mut self, now: Now, item: &Item, bytes: &[u8]) -> Result<(), RestoreError> {
        match item {
            Item::Floor => self.entities.restore_forgotten(now, decode_item(bytes)?),
            Item::Switch(switch) => self.restore_switch(*switch, decode_item(bytes)?)?,
            Item::Revocation(name) => {
                let kept: SignedRevocation = decode_item(bytes)?;
                let claims = kept.verify()?;
                if claims.name != *name {
                    return Err(RestoreError::Misplaced);
                }
                self.recall(vec![(kept, claims)]);
            }
            Item::Invitation(_) => {}
            Item::Entity(entity) => self.restore_entity(now, *entity, decode_item(bytes)?),
            Item::Registration(place) => self.restore_registration(now, place, decode_item(bytes)?)?,
            Item::KeyBox { .. } => self.restore_box(now, item, decode_item(bytes)?)?,
        }
        Ok(())
    }

    /// Ends the restoration. Forgets entities without an attachment or a name.
    pub fn restored(&mut self) {
        self.entities.retire_unused();
    }

    fn restore_switch(&mut self, switch: Name, bit: u8) -> Result<(), RestoreError> {
        if usize::from(bit) >= EGRESS_SET_SIZE as usize || self.bits.all().any(|(_, given)| given == bit) {
            return Err(RestoreError::Unbound);
        }
        self.bits.give(switch, Some(bit), |_| false).map_err(|_| RestoreError::Unbound)?;
        self.switches.entry(switch).or_default();
        self.silent.insert(switch);
        Ok(())
    }

    fn restore_entity(&mut self, now: Now, entity: Name, stored: StoredEntity) {
        self.entities.restore(now, entity, stored.floor, stored.through);
        for StoredAttachment { lane, switch, ends } in stored.attachments {
            let limit = self.limits.attached_per_switch;
            let Some(state) = self.switches.get_mut(&switch).filter(|state| state.attached.len() < limit) else {
                continue;
            };
            if ends <= now.unix || usize::from(lane) >= MAX_LANES {
                continue;
            }
            let ends = now.clock.saturating_add(Duration::from_secs(ends - now.unix));
            self.entities.attach(entity, lane, Attachment { switch, ends });
            state.attached.insert(entity);
            self.timers.insert((ends, Timer::Attachment { entity, lane }));
        }
    }

    fn restore_registration(
        &mut self,
        now: Now,
        place: &RecordKey,
        stored: StoredRegistration,
    ) -> Result<(), RestoreError> {
        let StoredRegistration { record, ends, everywhere, bound } = stored;
        if record.key()? != *place {
            return Err(RestoreError::Misplaced);
        }
        let RecordKey { name, role, entity, switch } = *place;
        let verified = record.verify(self.revocations.claims(name.as_bytes()), now.unix)?;
        // A stored registration lasts no longer than one stated now.
        let last = verified.not_after.min(now.unix.saturating_add(verified.advert.lifetime.into()));
        let ends = ends.min(last);
        if ends <= now.unix {
            return Err(RestoreError::Over);
        }
        let is_there = if bound { self.entities.is_attached_at(&entity, &switch) } else { true };
        if !self.switches.contains_key(&switch) || !is_there {
            return Err(RestoreError::Unbound);
        }
        let spent = verified.advert.serial.max(self.entities.floor(&entity));
        self.entities.restore(now, entity, spent, switch);
        let scope = record.credential.scope()?;
        let Record { proof, entity: shown, credential, advert, .. } = record;
        let registration = Registration {
            by: self.entities.identity(entity, shown, verified.advert.box_key),
            switch,
            remote: None,
            role,
            credential,
            advert,
            serial: verified.advert.serial,
            scope: shared(scope),
            everywhere,
            ends: now.clock.saturating_add(Duration::from_secs(ends - now.unix)),
            bound,
            sent_update: 0,
        };
        let registration_key = RegistrationKey { name: name.to_bytes(), entity, role };
        self.register(registration_key, proof, registration)?;
        if bound {
            self.peer_updates.resume(registration_key, switch);
        }
        Ok(())
    }

    fn restore_box(&mut self, now: Now, item: &Item, signed: Signed<KeyBox>) -> Result<(), RestoreError> {
        let claims = signed.claims_unverified()?;
        let (name, writer) = (claims.name, claims.writer);
        if *item != (Item::KeyBox { name, writer, epoch: claims.epoch, reader: claims.reader }) {
            return Err(RestoreError::Misplaced);
        }
        let proof = self.proof_of(&writer).ok_or(RestoreError::Unbound)?;
        // The writer may be attached to several switches, but may send to an inbox through one of
        // them only.
        let switches = self.entities.attachments(&writer).map(|(_, attachment)| attachment.switch);
        let mut here: BTreeSet<Name> = switches.collect();
        here.extend(self.entities.known(&writer).map(|(_, through)| through));
        let mut outcome = Err(RestoreError::Unbound);
        for switch in here {
            let requester: Requester = self.requester(now, switch, &proof)?;
            match self.key_boxes(now, &requester, std::slice::from_ref(&signed)) {
                Ok(_) => return Ok(()),
                Err(refusal) => outcome = Err(refusal.into()),
            }
        }
        outcome
    }

    /// Returns the proof of an entity's name, if the entity is registered for any name.
    fn proof_of(&self, entity: &Name) -> Option<NameProof> {
        let mut names = self.entities.names(entity).iter();
        let of = |name| NameRole::ALL.iter().find_map(|role| self.names.get(name, entity, *role));
        names.find_map(of).map(|registration| registration.by.proof)
    }
}
