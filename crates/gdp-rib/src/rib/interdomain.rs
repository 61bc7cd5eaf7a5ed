//! Registrations of entities of other domains, as announced by neighbouring RIBs. The RIB stores
//! them like local ones and routes them over the borders that [`super::border_links`] elects.
//! [`super::exports`] announces them to further RIBs.

use crate::rib::border_links::BorderLink;
use crate::rib::remote_registrations::Foreign;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use gdp_core::cert::{CertError, Signed};
use gdp_core::keys::KeyBox;
use gdp_core::name::NameProof;
use gdp_proto::control::{NameRole, RecordKey, Refusal, RefusalCode};
use gdp_wire::Name;

use super::border_links::{Changed, GRACE};
use super::{Rib, Timer};
use crate::rib::model::{InboxOwner, NameBytes, Now, Realm, RegistrationKey, lifetime, limit_reached, refusal};
use crate::rib::registration::{EntityIdentity, Registration, Remote, shared};

impl Rib {
    /// Adds or replaces the record of one registration that the neighbour `foreign.next` announced.
    ///
    /// The RIB verifies everything except the domain of the entity's switch. If several neighbours
    /// announce the same registration, the newest statement counts, then the fewest hops. The RIB
    /// keeps the other announcements as spares. Key boxes are stored in order up to the first
    /// refused one, whose refusal is returned.
    pub fn set_foreign(&mut self, now: Now, foreign: Foreign) -> Result<Option<Refusal>, Refusal> {
        self.tick(now);
        let Foreign { record, domain, next, hops, boxes, local } = foreign;
        let place = record.key().map_err(refusal)?;
        let (key, role) = (record.name.to_bytes(), place.role);
        // This check precedes signature verification, because neighbours repeat records that did
        // not fit.
        self.check_record_limit(&place, &next)?;
        let verified = record.verify(self.revocations.claims(&key), now.unix).map_err(refusal)?;
        record.credential.check_member(|domain| self.domains.get(domain)).map_err(refusal)?;
        let (entity, advert) = (verified.entity, verified.advert);
        let registration_key = RegistrationKey { name: key, entity, role };
        self.check_foreign(registration_key, &place.switch, &next, advert.serial)?;
        let seconds = u32::try_from(record.expires_in).unwrap_or(u32::MAX).min(advert.lifetime);
        let scope = record.credential.scope().map_err(refusal)?;
        let new = Registration {
            by: Arc::new(EntityIdentity { name: entity, proof: record.entity, box_key: advert.box_key }),
            switch: record.switch,
            remote: Some(Box::new(Remote { realm: Realm { next, domain }, hops, local })),
            role,
            credential: record.credential,
            advert: record.advert,
            serial: advert.serial,
            scope: shared(scope),
            everywhere: false,
            ends: lifetime(now, seconds, verified.not_after)?,
            bound: true,
            sent_update: 0,
        };
        if self.next_of(&place) == Some(next) {
            self.store(registration_key, record.proof, new)?;
        } else {
            self.remote.put_spare(place, next, (record.proof, new));
        }
        self.choose_record(now, place)?;
        self.forget_here(registration_key, advert.serial);
        Ok(boxes.iter().find_map(|signed| self.foreign_box(now, registration_key, &record.entity, signed).err()))
    }

    /// Returns the neighbours that announced a record, including those whose record is only a
    /// spare.
    pub fn sources_of(&self, place: &RecordKey) -> Vec<Name> {
        let spare = self.remote.spare.get(place).into_iter().flat_map(BTreeMap::keys).copied();
        self.next_of(place).into_iter().chain(spare).collect()
    }

    /// Returns the neighbour whose record is in use.
    pub fn next_of(&self, place: &RecordKey) -> Option<Name> {
        let registration = self.names.get_at(place.name.as_bytes(), &place.entity, place.role, &place.switch)?;
        registration.remote.as_ref().map(|remote| remote.realm.next)
    }

    /// Withdraws the record that the neighbour `next` announced.
    pub fn remove_foreign(&mut self, now: Now, place: &RecordKey, next: &Name) {
        self.tick(now);
        self.remote.take_spare(place, next);
        if self.next_of(place) == Some(*next) {
            self.end(now, registration_key_of(place), place.switch);
        }
    }

    /// Removes all records of a neighbour that is gone for good.
    pub fn remove_foreign_of(&mut self, now: Now, next: &Name) {
        let names = self.remote.names.iter().filter(|(realm, _)| realm.next == *next);
        let names: BTreeSet<NameBytes> = names.flat_map(|(_, names)| names.keys().copied()).collect();
        let spare = self.remote.spare.iter().filter(|(_, spare)| spare.contains_key(next)).map(|(place, _)| *place);
        let used = names.iter().flat_map(|name| self.names.keys(Name::from_bytes(*name)));
        let places: Vec<RecordKey> = spare.chain(used).collect();
        places.iter().for_each(|place| self.remove_foreign(now, place, next));
    }

    /// Replaces the links into all neighbouring domains. A domain without links of its own is
    /// reached by the links to the neighbour that announced its entities.
    pub fn set_ways(&mut self, now: Now, ways: BTreeMap<Name, Vec<BorderLink>>) {
        self.tick(now);
        let changed = self.ways.set(now.clock, ways, self.limits.ways_per_domain);
        if !changed.is_empty() {
            self.timers.insert((now.clock + GRACE, Timer::BorderLinks));
            self.follow_ways(&changed);
        }
    }

    pub(super) fn end_earlier_ways(&mut self, now: Now) {
        let changed = self.ways.end(now.clock);
        self.follow_ways(&changed);
    }

    /// Updates routes after a border gained or lost its egress bit.
    pub(super) fn follow_border(&mut self, border: Name) {
        let domains = self.ways.domains_over(&border).into_iter();
        self.follow_ways(&domains.map(|domain| (domain, BTreeSet::from([border]))).collect());
    }

    /// Removes the remote registrations of an entity that a newer local statement supersedes.
    pub(super) fn forget_remote(&mut self, registration_key: RegistrationKey, serial: u64) {
        let earlier = self.names.all_of(&registration_key.name, &registration_key.entity, registration_key.role);
        let earlier = earlier.filter(|earlier| !earlier.is_here() && earlier.serial < serial);
        let switches: Vec<Name> = earlier.map(|earlier| earlier.switch).collect();
        for switch in switches {
            self.unregister(registration_key, switch);
        }
    }

    /// Removes the local registrations of an entity that a newer remote statement supersedes. The
    /// entity has moved, though its switch here may not have noticed the loss of the link yet.
    fn forget_here(&mut self, registration_key: RegistrationKey, serial: u64) {
        let earlier = self.names.all_of(&registration_key.name, &registration_key.entity, registration_key.role);
        let earlier = earlier.filter(|it| it.is_here() && !it.everywhere && it.serial < serial);
        let switches: Vec<Name> = earlier.map(|earlier| earlier.switch).collect();
        switches.into_iter().for_each(|switch| self.unregister(registration_key, switch));
    }

    /// Ends a registration. A spare record from another neighbour then takes its place.
    pub(super) fn end(&mut self, now: Now, registration_key: RegistrationKey, switch: Name) {
        let place = record_key_of(registration_key, switch);
        self.unregister(registration_key, switch);
        if let Err(refusal) = self.choose_record(now, place) {
            tracing::warn!(%refusal, "what another domain told does not count now");
        }
    }

    fn check_foreign(
        &self,
        registration_key: RegistrationKey,
        switch: &Name,
        next: &Name,
        serial: u64,
    ) -> Result<(), Refusal> {
        let RegistrationKey { name, entity, role } = registration_key;
        if self.switches.contains_key(switch) {
            let reason = format!("switch {switch} is of this domain, and domain {next} tells that {entity} is there");
            return Err(Refusal::new(RefusalCode::WrongSwitch, reason));
        }
        if name == entity.to_bytes() {
            let reason = format!("{entity} is reached under its own name as it is, by its counterparts");
            return Err(Refusal::new(RefusalCode::Unsupported, reason));
        }
        let before = self.word_of(&record_key_of(registration_key, *switch), next);
        let since = self.names.all_of(&name, &entity, role).filter(|here| here.is_here() && !here.everywhere);
        if let Some(newer) = since.chain(before).find(|newer| newer.serial > serial) {
            return Err(refusal(CertError::ReplayedSerial { floor: newer.serial - 1, got: serial }));
        }
        Ok(())
    }

    fn check_record_limit(&self, place: &RecordKey, next: &Name) -> Result<(), Refusal> {
        let limit = self.limits.records_per_neighbour;
        if self.word_of(place, next).is_none() && self.remote.received.get(next).is_some_and(|told| *told >= limit) {
            return Err(limit_reached(format!("domain {next} has told of {limit} parts in names")));
        }
        Ok(())
    }

    /// Returns the registration that a neighbour announced, whether it is in use or a spare.
    fn word_of(&self, place: &RecordKey, next: &Name) -> Option<&Registration> {
        let used = self.names.get_at(place.name.as_bytes(), &place.entity, place.role, &place.switch);
        let used = used.filter(|used| used.remote.as_ref().is_some_and(|remote| remote.realm.next == *next));
        used.or_else(|| Some(&self.remote.spare.get(place)?.get(next)?.1))
    }

    /// Puts the best valid spare record of a registration into use.
    fn choose_record(&mut self, now: Now, place: RecordKey) -> Result<(), Refusal> {
        let (key, registration_key) = (place.name.to_bytes(), registration_key_of(&place));
        let used = self.names.get_at(&key, &place.entity, place.role, &place.switch).map(rank);
        let revocation = self.revocations.claims(&key);
        let stands = |spare: &Registration| {
            let is_member = || spare.credential.check_member(|domain| self.domains.get(domain)).is_ok();
            spare.ends > now.clock && revocation.is_none_or(|revocation| spare.stands_after(revocation)) && is_member()
        };
        let spare = self.remote.spare.get(&place).into_iter().flatten().filter(|(_, (_, spare))| stands(spare));
        let Some((next, (_, best))) = spare.min_by_key(|(_, (_, spare))| rank(spare)) else { return Ok(()) };
        let next = *next;
        if used.is_some_and(|used| used <= rank(best)) {
            return Ok(());
        }
        let Some((proof, best)) = self.remote.take_spare(&place, &next) else { return Ok(()) };
        match self.store(registration_key, proof, best.clone()) {
            Ok(Some(before)) => {
                if let Some(next) = before.remote.as_ref().map(|remote| remote.realm.next) {
                    self.remote.put_spare(place, next, (proof, before));
                }
                Ok(())
            }
            Ok(None) => Ok(()),
            // Kept as a spare until there is room.
            Err(refusal) => {
                self.remote.put_spare(place, next, (proof, best));
                Err(refusal)
            }
        }
    }

    /// Stores a key box of a remote entity, if the RIB knows what the box is for.
    fn foreign_box(
        &mut self,
        now: Now,
        registration_key: RegistrationKey,
        proof: &NameProof,
        signed: &Signed<KeyBox>,
    ) -> Result<(), Refusal> {
        let claims = signed.claims_unverified().map_err(refusal)?;
        if claims.writer != registration_key.entity {
            return Err(refusal(CertError::WrongEntity { expected: registration_key.entity, got: claims.writer }));
        }
        let told = self
            .names
            .all_of(&registration_key.name, &registration_key.entity, registration_key.role)
            .find(|told| !told.is_here());
        let Some(place) = told.map(|told| InboxOwner { entity: registration_key.entity, at: told.at() }) else {
            return Ok(());
        };
        let is_sent = registration_key.role == NameRole::Publisher && claims.name.to_bytes() == registration_key.name;
        let is_inbox = claims.name == claims.reader && self.inboxes.allows(claims.name, place);
        if !is_sent && !is_inbox || self.boxes.holds(&claims, signed) {
            return Ok(());
        }
        let not_a_key = |error| refusal(CertError::Crypto(error));
        signed.verify(&proof.verify_key().map_err(not_a_key)?, now.unix).map_err(refusal)?;
        self.boxes.put(place, &claims, signed.clone(), &self.limits)?;
        self.tell_reader(&claims);
        self.export_changed(&claims);
        Ok(())
    }

    /// Updates the desired FIBs after border links changed. Only names with registrations in the
    /// changed domains are recomputed.
    fn follow_ways(&mut self, changed: &Changed) {
        let mut names: BTreeMap<NameBytes, BTreeSet<Name>> = BTreeMap::new();
        for (realm, parts) in &self.remote.names {
            let concerned: Vec<_> =
                [realm.domain, realm.next].iter().filter_map(|domain| changed.get(domain)).collect();
            if concerned.is_empty() {
                continue;
            }
            let mut borders = self.ways.borders(realm);
            borders.extend(concerned.into_iter().flatten());
            parts.keys().for_each(|name| names.entry(*name).or_default().extend(&borders));
        }
        let mut inboxes: BTreeMap<Name, BTreeSet<Name>> = BTreeMap::new();
        for (name, borders) in names {
            for entity in self.names.entities(&name) {
                inboxes.entry(entity).or_default().extend(&borders);
            }
            self.follow_up_at(name, borders);
        }
        for (inbox, mut switches) in inboxes {
            switches.extend(self.inboxes.routed(&inbox, self.map()));
            self.reroute(inbox.to_bytes(), switches);
        }
    }
}

/// Ranks records of one registration: the lowest rank wins. Newer statements win, then fewer hops.
fn rank(registration: &Registration) -> (Reverse<u64>, u32, Option<Name>) {
    let remote = registration.remote.as_deref();
    let hops = remote.map_or(0, |remote| remote.hops);
    (Reverse(registration.serial), hops, remote.map(|remote| remote.realm.next))
}

fn record_key_of(registration_key: RegistrationKey, switch: Name) -> RecordKey {
    RecordKey {
        name: Name::from_bytes(registration_key.name),
        role: registration_key.role,
        entity: registration_key.entity,
        switch,
    }
}

fn registration_key_of(place: &RecordKey) -> RegistrationKey {
    RegistrationKey { name: place.name.to_bytes(), entity: place.entity, role: place.role }
}
