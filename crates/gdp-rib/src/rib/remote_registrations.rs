//! Registrations that RIBs of other domains announced, besides those in use.

use crate::rib::model::{NameBytes, Realm, count_out};
use crate::rib::registration::{Registration, Remote};
use gdp_core::cert::Signed;
use gdp_core::keys::KeyBox;
use gdp_core::name::NameProof;
use gdp_proto::control::{Record, RecordKey};
use gdp_wire::Name;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Registration of a remote entity, as announced by the RIB of its domain or of one on the way.
#[derive(Clone, Debug)]
pub struct Foreign {
    pub record: Record,
    /// Domain of the record's switch. The caller has verified its membership.
    pub domain: Name,
    /// Neighbouring domain that announced the registration. It is the next hop to `domain`.
    pub next: Name,
    /// Number of domains passed including the entity's own: 1 if it came directly from there.
    pub hops: u32,
    /// Key boxes for what the entity sends to the name and to its counterparts' inboxes, for
    /// readers that this RIB knows.
    pub boxes: Vec<Signed<KeyBox>>,
    /// Entities of this domain may know the registration. Otherwise it is only announced to further
    /// domains.
    pub local: bool,
}

/// State of other domains besides the registrations in use.
#[derive(Debug, Default)]
pub struct RemoteRegistrations {
    /// Names with registrations of each realm, and the number of registrations.
    pub names: BTreeMap<Realm, BTreeMap<NameBytes, usize>>,
    /// Spare records by registration and neighbour, in case the one in use is withdrawn.
    pub spare: BTreeMap<RecordKey, BTreeMap<Name, (NameProof, Registration)>>,
    /// Number of records that each neighbour announced, in use or spare.
    pub received: HashMap<Name, usize>,
    /// Records changed since they were last announced to other RIBs. `None` before the first query.
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
