//! Exports registrations to other RIBs, both local ones and those learned from other domains. It
//! tells which have changed and returns each with its key boxes. The caller decides which RIBs
//! receive them.

use std::collections::BTreeSet;

use gdp_core::cert::Signed;
use gdp_core::keys::KeyBox;
use gdp_proto::control::{NameRole, Record, RecordKey};
use gdp_wire::Name;

use super::Rib;
use crate::rib::model::Now;
use crate::rib::registration::Registration;

/// One registration as another RIB may receive it.
#[derive(Clone, Debug)]
pub struct Export {
    pub record: Record,
    /// Key boxes for readers in other domains, for the name and for the inboxes of the entity's
    /// counterparts.
    pub boxes: Vec<Signed<KeyBox>>,
    /// Domain of the entity and the neighbour that announced it. `None` for a local registration.
    pub origin: Option<(Name, Name)>,
}

impl Rib {
    /// Returns the keys of all records that changed since the last call, local and remote.
    ///
    /// The first call returns all records.
    pub fn take_changed_keys(&mut self) -> BTreeSet<RecordKey> {
        self.remote.changed.replace(BTreeSet::new()).unwrap_or_else(|| self.names.all_keys().collect())
    }

    /// Returns the export of one record, or `None` if the record no longer exists.
    pub fn export(&self, now: Now, place: &RecordKey) -> Option<Export> {
        let (record, registration) = self.names.record_at(now.clock, place)?;
        let origin = registration.remote.as_ref().map(|remote| (remote.realm.domain, remote.realm.next));
        Some(Export { record, boxes: self.boxes_for_other_domains(place, registration), origin })
    }

    /// Returns the exports of all records of a name.
    pub fn exports_of(&self, now: Now, name: &Name) -> impl Iterator<Item = Export> {
        self.names.keys(*name).filter_map(move |place| self.export(now, &place))
    }

    fn boxes_for_other_domains(&self, place: &RecordKey, registration: &Registration) -> Vec<Signed<KeyBox>> {
        let key = place.name.to_bytes();
        let others = self.names.bound(&key, place.role.counterpart());
        let remote = others.filter(|(_, other)| !other.is_here() && registration.meets(other));
        let remote: BTreeSet<Name> = remote.map(|(entity, _)| entity).collect();
        let sent = self
            .boxes
            .of(&key, &place.entity)
            .filter(|(reader, _)| place.role == NameRole::Publisher && remote.contains(reader));
        let inboxes = remote.iter().flat_map(|other| self.boxes.of(other.as_bytes(), &place.entity));
        sent.chain(inboxes).map(|(_, signed)| signed.clone()).collect()
    }

    /// Marks the records that a writer's new key box concerns as changed.
    pub(super) fn export_changed(&mut self, claims: &KeyBox) {
        let of_name = |name: &Name| self.names.keys(*name).filter(|place| place.entity == claims.writer).collect();
        let places: Vec<RecordKey> = match claims.name == claims.reader {
            false => of_name(&claims.name),
            true => {
                let names = self.entities.names(&claims.writer).iter().map(|name| Name::from_bytes(*name));
                let is_reader = |name: &Name| self.names.has(name.as_bytes(), &claims.reader);
                names.filter(is_reader).flat_map(|name| of_name(&name)).collect()
            }
        };
        places.into_iter().for_each(|place| self.remote.changed(place));
    }
}
