//! Statements of entities: their attachments and their registrations for names. The RIB verifies
//! and stores them. It then updates the routes of the names, the routes between counterparts, and
//! the entities to notify.

use crate::rib::model::lifetime;
use crate::rib::registration::Verified;
use std::collections::BTreeSet;
use std::time::Duration;

use gdp_core::cert::{CertError, Requester, authorise_advertise, authorise_subscribe, authorise_withdraw};
use gdp_core::name::NameProof;
use gdp_core::peer::MAX_LANES;
use gdp_proto::control::{Credential, EntityRequest, NameRole, RecordKey, Refusal, RefusalCode, Response, Route};
use gdp_wire::Name;

use super::border_links::Map;
use super::entities::Attachment;
use super::peer_updates::UpdateSource;
use super::{Rib, Timer};
use crate::rib::model::{At, InboxOwner, NameBytes, Now, RegistrationKey, limit_reached, refusal};
use crate::rib::registration::{Registration, shared};

/// Minimum time between two examinations of a name for expired registrations. In a name with very
/// many readers some expire all the time.
const BETWEEN_ENDS: Duration = Duration::from_secs(1);

impl Rib {
    pub(super) fn entity_request(
        &mut self,
        now: Now,
        origin: Name,
        entity: Option<&NameProof>,
        by_tool: bool,
        request: &EntityRequest,
    ) -> Result<Response, Refusal> {
        self.check_reported(origin)?;
        let proof = entity.ok_or_else(|| {
            Refusal::new(RefusalCode::Malformed, "only queries and revocations may be anonymous: show the entity's key")
        })?;
        let requester = self.requester(now, origin, proof)?;
        let here = self.entities.is_attached_at(&requester.entity, &origin);
        if !here && !by_tool && !matches!(request, EntityRequest::Attach { .. }) {
            let reason = format!("{} is not attached to switch {origin}; attach first", requester.entity);
            return Err(Refusal::new(RefusalCode::NotAttached, reason));
        }
        match request {
            EntityRequest::Attach { rt_cert, resumes, lane } => {
                let cert = rt_cert.verify(&requester.entity_key, now.unix).map_err(refusal)?;
                if cert.entity != requester.entity {
                    return Err(refusal(CertError::WrongEntity { expected: requester.entity, got: cert.entity }));
                }
                if cert.switch != origin {
                    return Err(refusal(CertError::WrongSwitch { expected: origin, got: cert.switch }));
                }
                if usize::from(*lane) >= MAX_LANES {
                    return Err(limit_reached(format!("an entity has {MAX_LANES} links, not one of number {lane}")));
                }
                if !by_tool {
                    let ends = now.clock.saturating_add(Duration::from_secs(cert.not_after - now.unix));
                    self.attach(&requester, *lane, ends, *resumes)?;
                }
                Ok(Response::Attached { serial: requester.floor })
            }
            EntityRequest::Advertise { proof: name, ad_cert, advert, everywhere } => {
                let revocation = name.name().ok().and_then(|name| self.revocations.claims(name.as_bytes()));
                let authorised = authorise_advertise(&requester, name, ad_cert, advert, revocation);
                let (cert, statement) = authorised.map_err(refusal)?;
                let verified = Verified {
                    name: *name,
                    credential: Credential::Writer(ad_cert.clone()),
                    signed: advert.clone(),
                    advert: statement,
                    everywhere: *everywhere,
                    scope: cert.scope,
                    not_after: cert.not_after,
                };
                self.state(now, &requester, *proof, by_tool, verified)
            }
            EntityRequest::Subscribe { proof: name, grant, advert, everywhere } => {
                let revocation = name.name().ok().and_then(|name| self.revocations.claims(name.as_bytes()));
                let authorised = authorise_subscribe(&requester, name, grant, advert, revocation);
                let (cert, statement) = authorised.map_err(refusal)?;
                grant.check_member(|domain| self.domains.get(domain)).map_err(refusal)?;
                let verified = Verified {
                    name: *name,
                    credential: Credential::Reader(grant.clone()),
                    signed: advert.clone(),
                    advert: statement,
                    everywhere: *everywhere,
                    scope: Vec::new(),
                    not_after: cert.not_after,
                };
                self.state(now, &requester, *proof, by_tool, verified)
            }
            EntityRequest::Withdraw { advert } => {
                let statement = authorise_withdraw(&requester, advert).map_err(refusal)?;
                let key = statement.name.to_bytes();
                if !self.names.has(&key, &requester.entity) {
                    let reason = format!("{} neither writes nor reads {}", requester.entity, statement.name);
                    return Err(Refusal::new(RefusalCode::NotFound, reason));
                }
                self.spend(now, &requester, statement.serial)?;
                for role in NameRole::ALL {
                    let registration_key = RegistrationKey { name: key, entity: requester.entity, role };
                    let switches = self.names.switches_of(&key, &requester.entity, role);
                    switches.into_iter().for_each(|switch| self.unregister(registration_key, switch));
                }
                Ok(Response::Done)
            }
            EntityRequest::KeyBoxes { boxes } => self.key_boxes(now, &requester, boxes),
            EntityRequest::Query { .. } | EntityRequest::Revoke { .. } => {
                Err(Refusal::new(RefusalCode::Malformed, "not a request of an entity"))
            }
        }
    }

    /// Stores a verified statement. Answers with the counterparts.
    fn state(
        &mut self,
        now: Now,
        requester: &Requester,
        proof: NameProof,
        by_tool: bool,
        verified: Verified,
    ) -> Result<Response, Refusal> {
        let Verified { name: name_proof, credential, signed, advert, everywhere, scope, not_after } = verified;
        self.spend(now, requester, advert.serial)?;
        let ends = lifetime(now, advert.lifetime, not_after);
        let role = NameRole::of(advert.op)
            .ok_or_else(|| Refusal::new(RefusalCode::Malformed, "a withdrawal states nothing about a name"));
        let registered = ends.and_then(|ends| {
            let (name, switch, box_key, bound) = (advert.name, requester.switch, advert.box_key, !by_tool);
            let (role, entity) = (role?, requester.entity);
            let registration = Registration {
                by: self.entities.identity(entity, proof, box_key),
                switch,
                remote: None,
                role,
                credential,
                advert: signed,
                serial: advert.serial,
                scope: shared(scope),
                everywhere,
                ends,
                bound,
                sent_update: 0,
            };
            let registration_key = RegistrationKey { name: name.to_bytes(), entity, role };
            self.register(registration_key, name_proof, registration).map(|()| registration_key)
        });
        let registration_key = registered.inspect_err(|_| self.entities.retire(&requester.entity))?;
        if !everywhere {
            let mut others =
                self.names.switches_of(&registration_key.name, &registration_key.entity, registration_key.role);
            others.retain(|switch| *switch != requester.switch);
            others.into_iter().for_each(|switch| self.unregister(registration_key, switch));
        }
        let other = self.other_switch_of(registration_key, &requester.switch);
        let (run, names, boxes, revocations) = (self.run.id, &self.names, &self.boxes, &self.revocations);
        let settling = now.clock < self.run.settling;
        let source = UpdateSource { run, settling, now: now.clock, names, boxes, revocations };
        if by_tool {
            return Ok(Response::Peers(self.peer_updates.once(registration_key, requester.switch, source)));
        }
        let (peers, held) = self.peer_updates.begin(registration_key, requester.switch, other.is_none(), source);
        if let Some(held) = held {
            self.names.note_sent(&registration_key, &requester.switch, held);
        }
        Ok(Response::Peers(peers))
    }

    pub(super) fn requester(&self, now: Now, switch: Name, proof: &NameProof) -> Result<Requester, Refusal> {
        let not_a_key = |error| refusal(CertError::Crypto(error));
        let entity = proof.name().map_err(not_a_key)?;
        let entity_key = proof.verify_key().map_err(not_a_key)?;
        Ok(Requester { entity, entity_key, switch, floor: self.entities.floor(&entity), now: now.unix })
    }

    fn spend(&mut self, now: Now, requester: &Requester, serial: u64) -> Result<(), Refusal> {
        self.entities.spend(now, requester.entity, requester.switch, serial, self.limits.unattached_per_switch)
    }

    /// Attaches one lane of an entity to a switch.
    ///
    /// A lane that attaches again to the same switch and resumes is only renewed, because the
    /// switch reports a lost link by a detach. Attaching a lane elsewhere ends its old attachment.
    /// The old switch is notified unless another lane is there, so that the entity does not believe
    /// it is still attached. An entity that starts anew has no other lanes.
    fn attach(&mut self, requester: &Requester, lane: u8, ends: Duration, resumes: bool) -> Result<(), Refusal> {
        let limit = self.limits.attached_per_switch;
        let full = |s: &super::Switch| s.attached.len() >= limit && !s.attached.contains(&requester.entity);
        if self.switches.get(&requester.switch).is_some_and(full) {
            return Err(limit_reached(format!("switch {} has {limit} attached entities", requester.switch)));
        }
        let entity = requester.entity;
        let earlier: Vec<_> = self.entities.attachments(&entity).collect();
        for (of, old) in earlier {
            if of == lane && old.switch == requester.switch && resumes {
                self.timers.remove(&(old.ends, Timer::Attachment { entity, lane }));
            } else if of == lane || !resumes {
                self.end_attachment(&entity, of);
                if old.switch != requester.switch && !self.entities.is_attached_at(&entity, &old.switch) {
                    self.detached.insert((old.switch, entity));
                }
            }
        }
        let Some(switch) = self.switches.get_mut(&requester.switch) else { return Ok(()) };
        self.entities.attach(entity, lane, Attachment { switch: requester.switch, ends });
        switch.attached.insert(entity);
        self.timers.insert((ends, Timer::Attachment { entity, lane }));
        Ok(())
    }

    /// Ends the attachments of all the entity's lanes at a switch.
    pub(super) fn end_attachments_at(&mut self, entity: &Name, switch: &Name) {
        let here = self.entities.attachments(entity).filter(|(_, attachment)| attachment.switch == *switch);
        let lanes: Vec<u8> = here.map(|(lane, _)| lane).collect();
        lanes.into_iter().for_each(|lane| self.end_attachment(entity, lane));
    }

    /// Ends one attachment. With the last lane at a switch, the entity's registrations there end
    /// too.
    pub(super) fn end_attachment(&mut self, entity: &Name, lane: u8) {
        let Some(Attachment { switch, ends }) = self.entities.take_attachment(entity, lane) else { return };
        self.timers.remove(&(ends, Timer::Attachment { entity: *entity, lane }));
        if !self.entities.is_attached_at(entity, &switch) {
            if let Some(switch) = self.switches.get_mut(&switch) {
                switch.attached.remove(entity);
            }
            for (name, role) in self.names.bound_of(entity, &switch, self.entities.names(entity)) {
                self.unregister(RegistrationKey { name, entity: *entity, role }, switch);
            }
            self.tell_elsewhere(RegistrationKey::inbox(*entity), &switch);
        }
        self.entities.retire(entity);
    }

    /// Stops updates to an entity through `switch` and resumes them through another switch of its
    /// registration.
    fn tell_elsewhere(&mut self, registration_key: RegistrationKey, switch: &Name) {
        let other = self.other_switch_of(registration_key, switch);
        self.peer_updates.follow(&registration_key, switch, other);
    }

    /// Returns another switch through which updates reach the entity.
    pub(super) fn other_switch_of(&self, registration_key: RegistrationKey, switch: &Name) -> Option<Name> {
        if registration_key.is_inbox() {
            let attachments = self.entities.attachments(&registration_key.entity);
            return attachments.map(|(_, attachment)| attachment.switch).find(|other| other != switch);
        }
        self.names
            .bound_at(&registration_key.name, &registration_key.entity, registration_key.role)
            .find(|other| other != switch)
    }

    pub(super) fn register(
        &mut self,
        registration_key: RegistrationKey,
        proof: NameProof,
        new: Registration,
    ) -> Result<(), Refusal> {
        let RegistrationKey { name: key, entity, role } = registration_key;
        let name = Name::from_bytes(key);
        if name == entity {
            let reason =
                format!("{entity} is reached under its own name as it is, by its counterparts; use another name");
            return Err(Refusal::new(RefusalCode::Unsupported, reason));
        }
        let names = self.entities.names(&entity);
        if names.len() >= self.limits.names_per_entity && !names.contains(&key) {
            return Err(limit_reached(format!("{entity} already has {} names", names.len())));
        }
        let (switch, everywhere, serial) = (new.switch, new.everywhere, new.serial);
        self.store(registration_key, proof, new)?;
        self.entities.add_name(&entity, key);
        if !everywhere {
            let mut others = self.names.switches_of(&key, &entity, role);
            others.retain(|other| *other != switch);
            others.into_iter().for_each(|switch| self.unregister(registration_key, switch));
            self.forget_remote(registration_key, serial);
        }
        Ok(())
    }

    /// Stores a verified registration. Returns the entity's previous one at the same switch.
    pub(super) fn store(
        &mut self,
        registration_key: RegistrationKey,
        proof: NameProof,
        new: Registration,
    ) -> Result<Option<Registration>, Refusal> {
        let RegistrationKey { name: key, entity, role } = registration_key;
        let (name, switch, at) = (Name::from_bytes(key), new.switch, new.at());
        self.names.check_room(&name, &entity, &new, &self.limits)?;
        if new.bound {
            let counterparts: Vec<InboxOwner> = self.counterparts(&key, &new).collect();
            self.inboxes.check_room(InboxOwner { entity, at }, &counterparts, &self.limits)?;
        }
        let (ends, bound, kind) = (new.ends, new.bound, new.kind());
        let says_the_same = self.names.tell_the_same(&key, &entity, role, &new);
        self.revocations.enter(&key, &self.limits);
        let is_new_name = !self.names.contains(&key);
        let is_stored = new.is_here();
        self.remote.enter(&new, key);
        let old = self.names.insert(name, proof, new);
        if is_stored {
            self.journal.mark(registration_key.at(switch));
        }
        self.expect_end(key, ends);
        let (mut places, mut told) = (vec![at], self.to_tell_of(registration_key, &switch));
        if let Some(old) = &old {
            self.remote.leave(old, &key);
            places.push(old.at());
            told.extend(self.who_knew(registration_key, old));
        }
        // New counterparts join before old ones part, so that those in both sets lose nothing.
        let was = old.as_ref().filter(|old| old.bound);
        if bound && was.is_none_or(|old| old.kind() != kind) {
            self.join(registration_key, &switch);
        }
        if let Some(was) = was.filter(|was| !bound || was.kind() != kind) {
            self.part(registration_key, was);
        }
        if was.is_some() && !bound {
            self.tell_elsewhere(registration_key, &switch);
        }
        self.follow_up(key, &places);
        if is_new_name {
            self.reroute_inbox(&name);
        }
        if !says_the_same {
            told.into_iter().for_each(|other| self.peer_updates.record_changed(&self.names, other, entity));
        }
        self.remote.changed(RecordKey { name, role, entity, switch });
        Ok(old)
    }

    /// Schedules the examination of the name for when a registration ends.
    fn expect_end(&mut self, name: NameBytes, ends: Duration) {
        if let Some(later) = self.names.look_by(&name, ends) {
            self.timers.remove(&(later, Timer::Name(name)));
            self.timers.insert((ends, Timer::Name(name)));
        }
    }

    /// Ends the expired registrations of a name.
    pub(super) fn end_due(&mut self, now: Now, name: NameBytes) {
        let (over, next) = self.names.look(&name, now.clock);
        over.into_iter().for_each(|(registration_key, switch)| self.end(now, registration_key, switch));
        if let Some(next) = next {
            self.expect_end(name, next.max(now.clock + BETWEEN_ENDS));
        }
    }

    pub(super) fn unregister(&mut self, registration_key: RegistrationKey, switch: Name) {
        let RegistrationKey { name, entity, role } = registration_key;
        let Some(old) = self.names.remove(&name, &entity, role, &switch) else { return };
        // The journal skips remote registrations, because other domains announce them again.
        if old.is_here() {
            self.journal.mark(registration_key.at(switch));
        }
        let says_the_same = self.names.tell_the_same(&name, &entity, role, &old);
        self.remote.leave(&old, &name);
        if old.bound {
            self.tell_elsewhere(registration_key, &switch);
            self.part(registration_key, &old);
        }
        if self.names.get(&name, &entity, NameRole::Publisher).is_none() {
            self.boxes.forget(&name, &entity);
        }
        if !self.names.has(&name, &entity) {
            self.entities.remove_name(&entity, &name);
            self.entities.retire(&entity);
        }
        self.follow_up(name, &[old.at()]);
        if !says_the_same {
            let told = self.who_knew(registration_key, &old);
            told.into_iter().for_each(|other| self.peer_updates.record_changed(&self.names, other, entity));
        }
        self.remote.changed(RecordKey { name: Name::from_bytes(name), role, entity, switch });
        if let Some(look) = self.names.sweep(&name) {
            self.timers.remove(&(look, Timer::Name(name)));
            self.reroute_inbox(&Name::from_bytes(name));
            self.revocations.leave(&name, &self.limits);
        }
    }

    /// Returns the counterparts of a registration.
    fn counterparts(&self, name: &NameBytes, registration: &Registration) -> impl Iterator<Item = InboxOwner> {
        let others = self.names.bound(name, registration.role.counterpart());
        let others = others.filter(|(_, other)| registration.meets(other));
        others.map(|(entity, other)| InboxOwner { entity, at: other.at() })
    }

    /// Lets an entity and its counterparts send to each other's inboxes, for its registration at
    /// `switch`.
    fn join(&mut self, registration_key: RegistrationKey, switch: &Name) {
        let mut affected = BTreeSet::new();
        let new = self.names.get_at(&registration_key.name, &registration_key.entity, registration_key.role, switch);
        for (inbox, sender) in new.map_or_else(Vec::new, |new| self.pairs(registration_key, new)) {
            let places = self.inboxes.allow(inbox, sender);
            affected.extend(places.into_iter().map(|at| (inbox.entity, at)));
        }
        self.reroute_inboxes(affected);
    }

    /// Removes the pairs of counterparts that an ended registration allowed.
    fn part(&mut self, registration_key: RegistrationKey, old: &Registration) {
        let mut affected = BTreeSet::new();
        for (inbox, sender) in self.pairs(registration_key, old) {
            let (places, ended) = self.inboxes.deny(inbox, sender);
            if ended {
                self.boxes.forget(inbox.entity.as_bytes(), &sender.entity);
            }
            affected.extend(places.into_iter().map(|at| (inbox.entity, at)));
        }
        self.reroute_inboxes(affected);
    }

    /// Returns the pairs (inbox, sender) that a registration allows.
    fn pairs(&self, registration_key: RegistrationKey, registration: &Registration) -> Vec<(InboxOwner, InboxOwner)> {
        let place = InboxOwner { entity: registration_key.entity, at: registration.at() };
        let others =
            self.counterparts(&registration_key.name, registration).filter(|other| other.entity != place.entity);
        others.flat_map(|other| [(place, other), (other, place)]).collect()
    }

    /// Returns the registrations to notify of the entity's registration at `switch`.
    fn to_tell_of(&self, registration_key: RegistrationKey, switch: &Name) -> Vec<RegistrationKey> {
        let stated = self.names.get_at(&registration_key.name, &registration_key.entity, registration_key.role, switch);
        stated.map_or_else(Vec::new, |stated| self.who_knew(registration_key, stated))
    }

    /// Returns the local registrations that were notified of `stated`. Other RIBs notify the
    /// entities of their own domains.
    fn who_knew(&self, registration_key: RegistrationKey, stated: &Registration) -> Vec<RegistrationKey> {
        let (name, role) = (registration_key.name, registration_key.role.counterpart());
        let others = self.names.bound(&name, role).filter(|(_, other)| other.is_here());
        let others = others.filter(|(_, other)| stated.meets(other));
        others.map(|(entity, _)| RegistrationKey { name, entity, role }).collect()
    }

    /// Updates the desired FIBs for one name after a change at these locations.
    pub(super) fn follow_up(&mut self, name: NameBytes, at: &[At]) {
        let map = self.map();
        let switches = at.iter().flat_map(|at| map.switches(at)).collect();
        self.follow_up_at(name, switches);
    }

    /// Updates the desired FIBs for one name after a change at these switches.
    pub(super) fn follow_up_at(&mut self, name: NameBytes, at: BTreeSet<Name>) {
        let map = Map { bits: &self.bits, ways: &self.ways };
        let switches = self.names.reroute(&name, at, map);
        self.reroute(name, switches);
    }

    pub(super) fn reroute_inbox(&mut self, entity: &Name) {
        let switches = self.inboxes.routed(entity, self.map());
        self.reroute(entity.to_bytes(), switches);
    }

    fn reroute_inboxes(&mut self, affected: BTreeSet<(Name, At)>) {
        for (inbox, at) in affected {
            let switches = self.map().switches(&at);
            self.reroute(inbox.to_bytes(), switches);
        }
    }

    /// Sets the route of a name at these switches. While a name is registered, it is routed by its
    /// registrations and not as an inbox. Only the key of an entity can allow registrations for its
    /// name.
    pub(super) fn reroute(&mut self, name: NameBytes, switches: impl IntoIterator<Item = Name>) {
        let is_stated = self.names.contains(&name);
        for switch in switches {
            let map = self.map();
            let route = match is_stated {
                true => self.stated_route(&name, &switch),
                false => self.inboxes.route(&name, &switch, map),
            };
            if let Some(state) = self.switches.get_mut(&switch) {
                state.fib.set(&Name::from_bytes(name), route);
            }
        }
    }

    /// Returns the route of a registered name. The owner of such a name may still be in another
    /// domain and send from there.
    fn stated_route(&self, name: &NameBytes, switch: &Name) -> Option<Route> {
        let arrives_by = self.inboxes.arrives_by(name, switch, self.map());
        let route = self.names.route(name, switch, self.map());
        let none = || Route { name: Name::from_bytes(*name), ..Route::default() };
        let route = route.or_else(|| (!arrives_by.is_empty()).then(none))?;
        Some(Route { arrives_by, ..route })
    }

    pub(super) fn map(&self) -> Map<'_> {
        Map { bits: &self.bits, ways: &self.ways }
    }
}
