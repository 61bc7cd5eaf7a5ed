//! Registrations of each name (publishers, servers, subscribers and callers) with the certificates
//! that prove them, and the switches that need a route for it.

use crate::rib::model::NameBytes;
use crate::rib::registration::Registration;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::cert::Revocation;
use gdp_core::name::{NamePrefix, NameProof};
use gdp_proto::control::{NameRole, Record, RecordKey, Refusal, RefusalCode, Response, Route};
use gdp_wire::Name;

use super::border_links::Map;
use super::topic::{Registrations, Topic, distinct};
use crate::rib::model::{At, Limits, RegistrationKey, limit_reached};

/// Maximum bytes of records in one message. The rest of 64 KiB is for the envelope.
pub(super) const RECORDS_SIZE: usize = 56 * 1024;

/// Sorts after all switches of an entity.
pub(super) const LAST: Name = Name::from_bytes([0xff; 32]);

#[derive(Debug, Default)]
pub(super) struct Names {
    all: BTreeMap<NameBytes, Box<Topic>>,
    /// Names for which [`Topic::has_no_writer`] holds.
    without_publisher: BTreeSet<NameBytes>,
}

impl Names {
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Returns the number of names with readers but no writer, and an iterator over them. It
    /// examines no other name.
    pub fn without_publisher(&self) -> (usize, impl Iterator<Item = Name>) {
        (self.without_publisher.len(), self.without_publisher.iter().copied().map(Name::from_bytes))
    }

    /// Checks that one more registration is within the limits.
    ///
    /// A name is either published (a topic) or served (a service), not both.
    pub fn check_room(&self, name: &Name, entity: &Name, new: &Registration, limits: &Limits) -> Result<(), Refusal> {
        let Some(topic) = self.all.get(name.as_bytes()) else {
            let limit = limits.names;
            return if self.all.len() < limit {
                Ok(())
            } else {
                Err(limit_reached(format!("{limit} names are known")))
            };
        };
        let part = topic.part(new.role);
        if !new.role.is_writer() {
            let limit = limits.readers_per_switch;
            if part.count_at(&new.at()) >= limit && part.get(entity, &new.switch).is_none() {
                let place = match new.at() {
                    At::Here(switch) => format!("at switch {switch}"),
                    At::RemoteRegistrations(realm) => format!("in domain {}", realm.domain),
                };
                return Err(limit_reached(format!("{name} has {limit} {}s {place}", new.role)));
            }
            return Ok(());
        }
        let (limit, other) = (
            limits.writers_per_name,
            if new.role == NameRole::Server { NameRole::Publisher } else { NameRole::Server },
        );
        if !topic.part(other).is_empty() {
            let reason = format!("{name} has a {other} already, and cannot have a {} too: use another name", new.role);
            return Err(Refusal::new(RefusalCode::Unsupported, reason));
        }
        if part.of(entity).next().is_none() && part.entities().count() >= limit {
            return Err(limit_reached(format!("{name} has {limit} {}s", new.role)));
        }
        Ok(())
    }

    /// Stores a registration that [`Self::check_room`] allowed. Returns the replaced one.
    pub fn insert(&mut self, name: Name, proof: NameProof, new: Registration) -> Option<Registration> {
        let topic = self.all.entry(name.to_bytes()).or_insert_with(|| Topic::new(proof).into());
        let replaced = topic.insert(new);
        note_without_writer(&mut self.without_publisher, name.to_bytes(), topic);
        replaced
    }

    pub fn remove(&mut self, name: &NameBytes, entity: &Name, role: NameRole, switch: &Name) -> Option<Registration> {
        let topic = self.all.get_mut(name)?;
        let removed = topic.remove(entity, role, switch);
        note_without_writer(&mut self.without_publisher, *name, topic);
        removed
    }

    /// Removes a name without registrations. Returns the time at which it was to be
    /// [examined](Self::look), if it was removed.
    pub fn sweep(&mut self, name: &NameBytes) -> Option<Duration> {
        self.all.get(name).filter(|topic| topic.parts().next().is_none())?;
        self.all.remove(name).map(|topic| topic.look_at)
    }

    /// Schedules the name's examination for `ends` at the latest. Returns the earlier schedule if
    /// `ends` is sooner.
    pub fn look_by(&mut self, name: &NameBytes, ends: Duration) -> Option<Duration> {
        let topic = self.all.get_mut(name).filter(|topic| ends < topic.look_at)?;
        Some(std::mem::replace(&mut topic.look_at, ends))
    }

    /// Returns the expired registrations of a name and the time when the next one expires. The name
    /// is not examined again before a call of [`Self::look_by`].
    pub fn look(&mut self, name: &NameBytes, now: Duration) -> (Vec<(RegistrationKey, Name)>, Option<Duration>) {
        let Some(topic) = self.all.get_mut(name) else { return (Vec::new(), None) };
        topic.look_at = Duration::MAX;
        let all = || topic.parts().flat_map(Registrations::iter);
        let over = all().filter(|(_, registration)| registration.ends <= now);
        let over =
            over.map(|((entity, switch), r)| (RegistrationKey { name: *name, entity, role: r.role }, switch)).collect();
        (over, all().map(|(_, registration)| registration.ends).filter(|ends| *ends > now).min())
    }

    /// Records the generation of updates that an entity holds, when no further updates are pending.
    pub fn note_sent(&mut self, registration_key: &RegistrationKey, switch: &Name, held: u64) {
        let topic = self.all.get_mut(&registration_key.name);
        if let Some(registration) =
            topic.and_then(|topic| topic.get_mut(&registration_key.entity, registration_key.role, switch))
        {
            registration.sent_update = held;
        }
    }

    /// Returns the highest generation [noted](Self::note_sent) for a registration, and its switch.
    pub fn last_update(&self, registration_key: &RegistrationKey) -> Option<(Name, u64)> {
        let all = self.all_of(&registration_key.name, &registration_key.entity, registration_key.role);
        let last = all
            .filter(|registration| registration.sent_update > 0)
            .max_by_key(|registration| registration.sent_update)?;
        Some((last.switch, last.sent_update))
    }

    pub fn contains(&self, name: &NameBytes) -> bool {
        self.all.contains_key(name)
    }

    /// Returns the entity's registration that ends last. Its counterparts are told of this one.
    pub fn get(&self, name: &NameBytes, entity: &Name, role: NameRole) -> Option<&Registration> {
        self.all.get(name)?.part(role).of(entity).max_by_key(|registration| registration.ends)
    }

    pub fn get_at(&self, name: &NameBytes, entity: &Name, role: NameRole, switch: &Name) -> Option<&Registration> {
        self.all.get(name)?.part(role).get(entity, switch)
    }

    /// Returns all registrations of an entity in this role, local and remote.
    pub fn all_of(&self, name: &NameBytes, entity: &Name, role: NameRole) -> impl Iterator<Item = &Registration> {
        self.all.get(name).into_iter().flat_map(move |topic| topic.part(role).of(entity))
    }

    /// Returns whether the entity has registrations in this role and all of them tell the same as
    /// `other`.
    pub fn tell_the_same(&self, name: &NameBytes, entity: &Name, role: NameRole, other: &Registration) -> bool {
        let mut all = self.all_of(name, entity, role).peekable();
        all.peek().is_some() && all.all(|registration| registration.tells_the_same(other))
    }

    /// Returns the proof of how the name is derived.
    pub fn proof(&self, name: &NameBytes) -> Option<NameProof> {
        self.all.get(name).map(|topic| topic.proof)
    }

    /// Returns the switches of this domain at which an entity has registered in this role.
    pub fn switches_of(&self, name: &NameBytes, entity: &Name, role: NameRole) -> Vec<Name> {
        let here = self.all_of(name, entity, role).filter(|registration| registration.is_here());
        here.map(|registration| registration.switch).collect()
    }

    /// Returns the record of `counterpart` to send to the registered entity, if the two are
    /// counterparts.
    pub fn record_for(&self, now: Duration, registration_key: &RegistrationKey, counterpart: &Name) -> Option<Record> {
        let RegistrationKey { name, entity, role } = registration_key;
        let topic = self.all.get(name)?;
        let own = topic.part(*role).of(entity).filter(|own| own.is_here()).max_by_key(|own| own.ends)?;
        let of = self.all_of(name, counterpart, role.counterpart()).filter(|other| own.meets(other));
        Some(of.max_by_key(|other| other.ends)?.record(now, Name::from_bytes(*name), topic.proof))
    }

    pub fn record_at(&self, now: Duration, place: &RecordKey) -> Option<(Record, &Registration)> {
        let topic = self.all.get(place.name.as_bytes())?;
        let registration = topic.part(place.role).get(&place.entity, &place.switch)?;
        Some((registration.record(now, place.name, topic.proof), registration))
    }

    pub fn has(&self, name: &NameBytes, entity: &Name) -> bool {
        self.all.get(name).is_some_and(|topic| topic.parts().any(|part| part.of(entity).next().is_some()))
    }

    /// Returns the switches that need a route for the name.
    pub fn routed(&self, name: &NameBytes, map: Map) -> BTreeSet<Name> {
        let topic = self.all.get(name).filter(|topic| topic.is_routed());
        topic.map_or_else(BTreeSet::new, |topic| topic.switches(map))
    }

    /// Returns the entities with this role that can be reached, each with every one of its
    /// registrations.
    pub fn bound(&self, name: &NameBytes, role: NameRole) -> impl Iterator<Item = (Name, &Registration)> {
        let all = self.all.get(name).into_iter().flat_map(move |topic| topic.part(role).iter());
        all.filter(|(_, registration)| registration.bound).map(|((entity, _), registration)| (entity, registration))
    }

    /// Returns the switches of this domain at which one entity can be reached in this role.
    pub fn bound_at(&self, name: &NameBytes, entity: &Name, role: NameRole) -> impl Iterator<Item = Name> {
        let here = self.all_of(name, entity, role).filter(|r| r.bound && r.is_here());
        here.map(|registration| registration.switch)
    }

    /// Returns all entities registered for the name, once for each of their roles.
    pub fn entities(&self, name: &NameBytes) -> impl Iterator<Item = Name> {
        self.all.get(name).into_iter().flat_map(|topic| topic.parts().flat_map(Registrations::entities))
    }

    /// Returns the keys of all records of a name.
    pub fn keys(&self, name: Name) -> impl Iterator<Item = RecordKey> {
        self.all.get(name.as_bytes()).into_iter().flat_map(move |topic| topic.keys(name))
    }

    /// Returns the keys of all records.
    pub fn all_keys(&self) -> impl Iterator<Item = RecordKey> {
        self.all.iter().flat_map(|(key, topic)| topic.keys(Name::from_bytes(*key)))
    }

    /// Returns the entities with this role that sort after `after`.
    pub fn behind_entity(&self, name: &NameBytes, role: NameRole, after: Option<Name>) -> impl Iterator<Item = Name> {
        let after = after.map(|after| (after, LAST));
        let all = self.all.get(name).into_iter().flat_map(move |topic| topic.part(role).behind(after));
        distinct(all.map(|(place, _)| place))
    }

    /// Returns the registrations of an entity that end with its attachment to a switch.
    pub fn bound_of(&self, entity: &Name, switch: &Name, names: &BTreeSet<NameBytes>) -> Vec<(NameBytes, NameRole)> {
        let each = names.iter().flat_map(|name| NameRole::ALL.map(|role| (*name, role)));
        each.filter(|(name, role)| self.get_at(name, entity, *role, switch).is_some_and(|r| r.bound)).collect()
    }

    /// Returns all registrations through one switch of this domain.
    pub fn registered_at(&self, switch: &Name) -> Vec<(NameBytes, Name, NameRole)> {
        let mut found = Vec::new();
        for (name, topic) in &self.all {
            for role in NameRole::ALL {
                found.extend(topic.part(role).at(&At::Here(*switch)).map(|(entity, _)| (*name, entity, role)));
            }
        }
        found
    }

    /// Returns the entity, role and switch of the name's registrations that a revocation
    /// invalidates.
    pub fn revoked(&self, name: &NameBytes, revocation: &Revocation) -> Vec<(Name, NameRole, Name)> {
        let all = self.all.get(name).into_iter().flat_map(|topic| topic.parts().flat_map(Registrations::iter));
        all.filter(|(_, r)| !r.stands_after(revocation)).map(|((entity, switch), r)| (entity, r.role, switch)).collect()
    }

    /// Returns the registrations, with their switches, whose credential rests on a membership that
    /// this domain has revoked.
    pub fn expelled(&self, of_domain: &Revocation) -> Vec<(RegistrationKey, Name)> {
        let newest = |domain: &Name| (*domain == of_domain.name).then_some(of_domain);
        let all = self.all.iter().flat_map(|(name, topic)| {
            let parts = topic.parts().flat_map(Registrations::iter);
            parts.map(|((entity, switch), r)| (RegistrationKey { name: *name, entity, role: r.role }, switch, r))
        });
        let gone = all.filter(|(.., r)| r.credential.check_member(newest).is_err());
        gone.map(|(registration_key, switch, _)| (registration_key, switch)).collect()
    }

    /// Recomputes where the name is routed, after registrations or border links at the switches
    /// `at` changed. Returns the switches whose route changes.
    pub fn reroute(&mut self, name: &NameBytes, at: BTreeSet<Name>, map: Map) -> BTreeSet<Name> {
        match self.all.get_mut(name) {
            Some(topic) => topic.reroute(name, at, map),
            None => at,
        }
    }

    /// Returns the route of a name at one switch, if the switch needs one.
    pub fn route(&self, name: &NameBytes, switch: &Name, map: Map) -> Option<Route> {
        self.all.get(name)?.route(name, switch, map)
    }

    /// Returns the records of the names with this prefix after `after`, as many as fit in one
    /// message. Records that entities of this domain may not know are left out.
    pub fn query(&self, now: Duration, prefix: &NamePrefix, after: Option<&RecordKey>) -> Response {
        let padded: Option<Name> = format!("{:0<64}", prefix.as_str()).parse().ok();
        let begin = padded.unwrap_or_default();
        let matching = self.behind(after, begin).take_while(|(name, ..)| prefix.matches(name));
        let matching =
            matching.filter(|(.., registration)| registration.remote.as_ref().is_none_or(|remote| remote.local));
        let mut room = RECORDS_SIZE;
        let mut records = Vec::new();
        for (name, topic, registration) in matching {
            match room.checked_sub(registration.size()) {
                Some(rest) => room = rest,
                None => return Response::Records { records, truncated: true },
            }
            records.push(registration.record(now, name, topic.proof));
        }
        Response::Records { records, truncated: false }
    }

    /// Returns at most `limit` records after `after`, and whether more follow.
    pub fn records(&self, now: Duration, after: Option<&RecordKey>, limit: usize) -> (Vec<Record>, bool) {
        let mut rest = self.behind(after, Name::default());
        let records = rest.by_ref().take(limit);
        let records = records.map(|(name, topic, registration)| registration.record(now, name, topic.proof)).collect();
        (records, rest.next().is_some())
    }

    /// Iterates over the registrations of names from `begin` on and after `after`, in the order of
    /// their keys.
    fn behind<'a>(
        &'a self,
        after: Option<&RecordKey>,
        begin: Name,
    ) -> impl Iterator<Item = (Name, &'a Topic, &'a Registration)> {
        let after = after.copied();
        let from = after.map_or(begin, |after| after.name.max(begin)).to_bytes();
        self.all.range(from..).flat_map(move |(key, topic)| {
            let name = Name::from_bytes(*key);
            let after = after.filter(|after| after.name == name);
            NameRole::ALL.into_iter().flat_map(move |role| {
                let first = match after {
                    Some(after) if role < after.role => None,
                    Some(after) if role == after.role => Some(Some((after.entity, after.switch))),
                    _ => Some(None),
                };
                let listed = first.map(|first| topic.part(role).behind(first));
                listed.into_iter().flatten().map(move |(_, registration)| (name, &**topic, registration))
            })
        })
    }
}

fn note_without_writer(without_publisher: &mut BTreeSet<NameBytes>, name: NameBytes, topic: &Topic) {
    match topic.has_no_writer() {
        true => without_publisher.insert(name),
        false => without_publisher.remove(&name),
    };
}
