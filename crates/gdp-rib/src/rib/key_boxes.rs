//! Stores the key boxes of a writer and notifies their readers.

use gdp_core::cert::{CertError, Requester, Signed};
use gdp_core::keys::KeyBox;
use gdp_proto::control::{NameRole, Refusal, RefusalCode, Response};
use gdp_wire::Name;

use super::Rib;
use crate::rib::model::{At, InboxOwner, Now, RegistrationKey, refusal};

impl Rib {
    /// Stores key boxes in order. Those before a refused one stay stored.
    ///
    /// A box may be for a reader that has not registered. Only an entity that proves the owner's
    /// grant receives it.
    pub(super) fn key_boxes(
        &mut self,
        now: Now,
        requester: &Requester,
        boxes: &[Signed<KeyBox>],
    ) -> Result<Response, Refusal> {
        for signed in boxes {
            let claims = signed.claims_unverified().map_err(refusal)?;
            if claims.writer != requester.entity {
                return Err(refusal(CertError::WrongEntity { expected: requester.entity, got: claims.writer }));
            }
            let place = self.sends_from(requester, &claims)?;
            if self.boxes.holds(&claims, signed) {
                continue;
            }
            // This check protects the RIB as much as the reader, which verifies the box again.
            signed.verify(&requester.entity_key, now.unix).map_err(refusal)?;
            self.boxes.put(place, &claims, signed.clone(), &self.limits)?;
            self.tell_reader(&claims);
            self.export_changed(&claims);
        }
        Ok(Response::Done)
    }

    /// Returns the location from which the writer sends. Refuses a writer that may not send to the
    /// box's name.
    fn sends_from(&self, requester: &Requester, claims: &KeyBox) -> Result<InboxOwner, Refusal> {
        let (name, entity) = (claims.name, requester.entity);
        if let Some(registration) = self.names.get(name.as_bytes(), &entity, NameRole::Publisher) {
            return Ok(InboxOwner { entity, at: registration.at() });
        }
        let here = InboxOwner { entity, at: At::Here(requester.switch) };
        if name == claims.reader && self.inboxes.allows(name, here) {
            return Ok(here);
        }
        let reason = format!("{entity} neither publishes {name}, nor is it a counterpart of that: advertise first");
        Err(Refusal::new(RefusalCode::NotEntitled, reason))
    }

    pub(super) fn tell_reader(&mut self, claims: &KeyBox) {
        let (name, entity) = (claims.name.to_bytes(), claims.reader);
        if self.names.get(&name, &claims.writer, NameRole::Publisher).is_some() {
            self.peer_updates.boxes_changed(
                &self.names,
                RegistrationKey { name, entity, role: NameRole::Subscriber },
                claims.writer,
            );
        }
        if let Some(switch) = self.inbox_home(claims) {
            self.peer_updates.inbox_boxes_changed(&self.names, RegistrationKey::inbox(entity), switch, claims.writer);
        }
    }

    /// Returns a switch of the reader if the box is for the reader's inbox.
    fn inbox_home(&self, claims: &KeyBox) -> Option<Name> {
        let mut attachments = self.entities.attachments(&claims.reader).filter(|_| claims.name == claims.reader);
        attachments.next().map(|(_, attachment)| attachment.switch)
    }
}
