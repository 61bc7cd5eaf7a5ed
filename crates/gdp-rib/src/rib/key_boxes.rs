//! Takes in the key boxes of a writer and has their readers told.

use gdp_core::cert::{CertError, Signed, Speaker};
use gdp_core::keys::KeyBox;
use gdp_proto::control::{NameRole, Refusal, RefusalCode, Response};
use gdp_wire::Name;

use super::Rib;
use crate::rib::model::At;
use crate::rib::model::Now;
use crate::rib::model::Place;
use crate::rib::model::Stake;
use crate::rib::model::refusal;

impl Rib {
    /// One after the other: those before one that is refused are kept. A box may be for a reader that is not there, or not
    /// yet: only one that shows the owner's grant is given it.
    pub(super) fn key_boxes(
        &mut self,
        now: Now,
        speaker: &Speaker,
        boxes: &[Signed<KeyBox>],
    ) -> Result<Response, Refusal> {
        for signed in boxes {
            let claims = signed.claims_unverified().map_err(refusal)?;
            if claims.writer != speaker.entity {
                return Err(refusal(CertError::WrongEntity { expected: speaker.entity, got: claims.writer }));
            }
            let place = self.sends_from(speaker, &claims)?;
            if self.boxes.holds(&claims, signed) {
                continue;
            }
            // For the reader's sake no more than for the RIB's: it verifies this again.
            signed.verify(&speaker.entity_key, now.unix).map_err(refusal)?;
            self.boxes.put(place, &claims, signed.clone(), &self.limits)?;
            self.tell_reader(&claims);
            self.tell_abroad(&claims);
        }
        Ok(Response::Done)
    }

    /// Where the writer sends from; a refusal if it may not send to the name of the box.
    fn sends_from(&self, speaker: &Speaker, claims: &KeyBox) -> Result<Place, Refusal> {
        let (name, entity) = (claims.name, speaker.entity);
        if let Some(registration) = self.names.get(name.as_bytes(), &entity, NameRole::Publisher) {
            return Ok(Place { entity, at: registration.at() });
        }
        let here = Place { entity, at: At::Here(speaker.switch) };
        if name == claims.reader && self.inboxes.allows(name, here) {
            return Ok(here);
        }
        let reason = format!("{entity} neither publishes {name}, nor is it a counterpart of that: advertise first");
        Err(Refusal::new(RefusalCode::NotEntitled, reason))
    }

    pub(super) fn tell_reader(&mut self, claims: &KeyBox) {
        let (name, entity) = (claims.name.to_bytes(), claims.reader);
        if self.names.get(&name, &claims.writer, NameRole::Publisher).is_some() {
            self.telling.boxes_changed(&self.names, Stake { name, entity, role: NameRole::Subscriber }, claims.writer);
        }
        if let Some(switch) = self.inbox_home(claims) {
            self.telling.inbox_boxes_changed(&self.names, Stake::inbox(entity), switch, claims.writer);
        }
    }

    /// A switch of the reader, if the box is for what comes to its inbox.
    fn inbox_home(&self, claims: &KeyBox) -> Option<Name> {
        let mut attachments = self.entities.attachments(&claims.reader).filter(|_| claims.name == claims.reader);
        attachments.next().map(|(_, attachment)| attachment.switch)
    }
}
