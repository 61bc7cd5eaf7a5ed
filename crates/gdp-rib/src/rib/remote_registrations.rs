//! The registrations that RIBs of other domains announce, besides those in use.

use crate::rib::model::{NameBytes, Realm, count_out};
use crate::rib::registration::{Registration, Remote};
use gdp_core::cert::Signed;
use gdp_core::keys::KeyBox;
use gdp_core::name::NameProof;
use gdp_proto::control::{Record, RecordKey};
use gdp_wire::Name;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// A part that an entity of another domain has in a name, as that domain's RIB told, or one
/// between.
#[derive(Clone, Debug)]
pub struct Foreign {
    pub record: Record,
    /// Of which the record's switch is a member; the caller has verified that.
    pub domain: Name,
    /// The neighbouring domain it came from: the next on the way to `domain`, where that has no
    /// border with this one.
    pub next: Name,
    /// Domains it has passed, its own included: 1 if it came from its own.
    pub hops: u32,
    /// Of what the entity sends to the name, and to those it meets there, for whom this RIB knows.
    pub boxes: Vec<Signed<KeyBox>>,
    /// Entities of this domain may know it; otherwise it is only told on to other domains.
    pub local: bool,
}

/// What is known of other domains besides the registrations in use.
#[derive(Debug, Default)]
pub struct RemoteRegistrations {
    /// The names that entities of a realm have a part in, and how many parts.
    pub names: BTreeMap<Realm, BTreeMap<NameBytes, usize>>,
    /// By place and neighbour: what would count if another one did not.
    pub spare: BTreeMap<RecordKey, BTreeMap<Name, (NameProof, Registration)>>,
    /// How many records each neighbour has told of, in use or not.
    pub received: HashMap<Name, usize>,
    /// What other RIBs are still to be told of; none before anybody has asked.
    pub changed: Option<BTreeSet<RecordKey>>,
}

impl RemoteRegistrations {
    pub fn enter(&mut self, registration: &Registration, name: NameBytes) {
        let Some(Remote { realm, .. }) = registration.remote.as_deref().copied() else { return };
        *self.names.entry(realm).or_default().entry(name).or_default() += 1;
        *self.received.entry(realm.next).or_default() += 1;
    }

    pub fn leave(&mut self, registration: &Registration, name: &NameBytes) {
        let Some(Remote { realm, .. }) = registration.remote.as_deref().copied() else { return };
        count_out(&mut self.received, &realm.next, 1);
        let Some(names) = self.names.get_mut(&realm) else { return };
        let Some(parts) = names.get_mut(name) else { return };
        *parts -= 1;
        if *parts == 0 {
            names.remove(name);
        }
        if names.is_empty() {
            self.names.remove(&realm);
        }
    }

    pub fn put_spare(&mut self, place: RecordKey, next: Name, spare: (NameProof, Registration)) {
        if self.spare.entry(place).or_default().insert(next, spare).is_none() {
            *self.received.entry(next).or_default() += 1;
        }
    }

    pub fn take_spare(&mut self, place: &RecordKey, next: &Name) -> Option<(NameProof, Registration)> {
        let spare = self.spare.get_mut(place)?;
        let taken = spare.remove(next)?;
        if spare.is_empty() {
            self.spare.remove(place);
        }
        count_out(&mut self.received, next, 1);
        Some(taken)
    }

    pub fn changed(&mut self, place: RecordKey) {
        self.changed.iter_mut().for_each(|changed| _ = changed.insert(place));
    }
}
