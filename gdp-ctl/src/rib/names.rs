//! Who publishes, serves, reads and calls each name, with the certificates that prove it, and which switches need a route
//! for it.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;
use std::time::Duration;

use gdp::cert::{Advert, Revocation, Signed};
use gdp::control::{Credential, NameRole, Record, RecordPlace, Refusal, RefusalCode, Response, Route};
use gdp::name::{NamePrefix, NameProof};
use gdp_wire::Name;

use super::{Limits, limit_reached};

/// A name by which maps are ordered as its hex digits are.
pub(super) type Key = [u8; 32];

/// Bytes of records in one message; what is left of 64 KiB is for what encloses them.
pub(super) const RECORDS_SIZE: usize = 56 * 1024;

/// What an encoded record has besides credential and statement: two proofs, two names, field names.
const RECORD_OVERHEAD: usize = 512;

/// Behind all switches of an entity.
const LAST: Name = Name::from_bytes([0xff; 32]);

/// One entity's part in a name, at one switch.
#[derive(Debug)]
pub(super) struct Registration {
    pub entity: NameProof,
    pub switch: Name,
    pub role: NameRole,
    pub credential: Credential,
    pub advert: Signed<Advert>,
    pub box_key: [u8; 33],
    /// Of the certificates in the credential that a revocation can take back: what they are, and their serials.
    pub serials: Vec<(&'static str, u64)>,
    /// What is stated at other switches stands besides; and this one sends it on each link of the entity.
    pub everywhere: bool,
    pub ends: Duration,
    /// Ends with the attachment of its entity; the entity is told of its counterparts, and can be reached by them.
    pub bound: bool,
}

impl Registration {
    pub fn size(&self) -> usize {
        RECORD_OVERHEAD + self.credential.size() + self.advert.as_bytes().len()
    }

    pub fn record(&self, now: Duration, name: Name, proof: NameProof) -> Record {
        Record {
            name,
            proof,
            entity: self.entity,
            switch: self.switch,
            credential: self.credential.clone(),
            advert: self.advert.clone(),
            expires_in: self.ends.saturating_sub(now).as_secs(),
        }
    }

    /// Whether a counterpart that knows `other` need not be told of this one. Who calls a service wants to know where its servers are.
    pub fn tells_the_same(&self, other: &Self) -> bool {
        let is_as_near = self.role != NameRole::Server || self.switch == other.switch;
        self.credential == other.credential && self.box_key == other.box_key && is_as_near
    }
}

#[derive(Debug)]
struct Topic {
    proof: NameProof,
    /// By role.
    parts: [Registrations; NameRole::ALL.len()],
    /// The egress bits of the switches of its subscribers, as of the last [`Names::reroute`]; 0 while there are no routes: for as long as
    /// nobody publishes it, and of a service, whose servers and callers send to each other's own names.
    egress_bits: u64,
}

/// Those who have one role in a name; an entity as often as it has stated it at different switches.
#[derive(Debug, Default)]
struct Registrations {
    /// And by switch.
    by_entity: BTreeMap<(Name, Name), Registration>,
    by_switch: BTreeMap<Name, BTreeSet<Name>>,
}

#[derive(Debug, Default)]
pub(super) struct Names(BTreeMap<Key, Topic>);

impl Names {
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether one more registration is allowed.
    ///
    /// A name is published or served, not both: it is of a topic or of a service.
    pub fn check_room(&self, name: &Name, entity: &Name, new: &Registration, limits: &Limits) -> Result<(), Refusal> {
        let Some(topic) = self.0.get(name.as_bytes()) else {
            let limit = limits.names;
            return if self.0.len() < limit { Ok(()) } else { Err(limit_reached(format!("{limit} names are known"))) };
        };
        let part = topic.part(new.role);
        if !new.role.is_writer() {
            let limit = limits.readers_per_switch;
            return match part.by_switch.get(&new.switch) {
                Some(here) if here.len() >= limit && !here.contains(entity) => {
                    Err(limit_reached(format!("{name} has {limit} {}s at switch {}", new.role, new.switch)))
                }
                _ => Ok(()),
            };
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

    /// Stores what [`Self::check_room`] allowed. Returns what it replaces.
    pub fn insert(&mut self, name: Name, proof: NameProof, entity: Name, new: Registration) -> Option<Registration> {
        let topic =
            self.0.entry(name.to_bytes()).or_insert_with(|| Topic { proof, parts: Default::default(), egress_bits: 0 });
        topic.part_mut(new.role).insert(entity, new)
    }

    pub fn remove(&mut self, name: &Key, entity: &Name, role: NameRole, switch: &Name) -> Option<Registration> {
        self.0.get_mut(name)?.part_mut(role).remove(entity, switch)
    }

    /// Drops a name that nobody has any part in; whether it did.
    pub fn sweep(&mut self, name: &Key) -> bool {
        let unused = self.0.get(name).is_some_and(|topic| topic.parts.iter().all(Registrations::is_empty));
        if unused {
            self.0.remove(name);
        }
        unused
    }

    pub fn contains(&self, name: &Key) -> bool {
        self.0.contains_key(name)
    }

    /// What an entity has stated, wherever: what its counterparts are told of.
    pub fn get(&self, name: &Key, entity: &Name, role: NameRole) -> Option<&Registration> {
        self.0.get(name)?.part(role).of(entity).max_by_key(|registration| registration.ends)
    }

    pub fn get_at(&self, name: &Key, entity: &Name, role: NameRole, switch: &Name) -> Option<&Registration> {
        self.0.get(name)?.part(role).by_entity.get(&(*entity, *switch))
    }

    /// The switches at which an entity has stated this.
    pub fn switches_of(&self, name: &Key, entity: &Name, role: NameRole) -> Vec<Name> {
        let part = self.0.get(name).map(|topic| topic.part(role));
        part.into_iter().flat_map(|part| part.of(entity)).map(|registration| registration.switch).collect()
    }

    pub fn record(&self, now: Duration, name: &Key, entity: &Name, role: NameRole) -> Option<Record> {
        let proof = self.0.get(name)?.proof;
        Some(self.get(name, entity, role)?.record(now, Name::from_bytes(*name), proof))
    }

    pub fn has(&self, name: &Key, entity: &Name) -> bool {
        self.0.get(name).is_some_and(|topic| topic.parts.iter().any(|part| part.of(entity).next().is_some()))
    }

    /// Switches that a route for the name is for.
    pub fn routed(&self, name: &Key) -> impl Iterator<Item = &Name> {
        let topic = self.0.get(name).filter(|topic| topic.egress_bits != 0);
        topic.into_iter().flat_map(Topic::switches)
    }

    /// The attached entities with this role in a name, and their switches; one at each of its switches.
    pub fn bound(&self, name: &Key, role: NameRole) -> impl Iterator<Item = (Name, Name)> {
        let part = self.0.get(name).map(|topic| topic.part(role));
        let all = part.into_iter().flat_map(|part| &part.by_entity);
        all.filter(|(_, registration)| registration.bound).map(|(place, _)| *place)
    }

    /// The switches at which one entity is so.
    pub fn bound_at(&self, name: &Key, entity: &Name, role: NameRole) -> impl Iterator<Item = Name> {
        let part = self.0.get(name).map(|topic| topic.part(role));
        let of = part.into_iter().flat_map(|part| part.of(entity));
        of.filter(|registration| registration.bound).map(|registration| registration.switch)
    }

    /// Those with this role behind `after`.
    pub fn behind_entity(&self, name: &Key, role: NameRole, after: Option<Name>) -> impl Iterator<Item = Name> {
        let first = after.map_or(Bound::Unbounded, |after| Bound::Excluded((after, LAST)));
        let part = self.0.get(name).map(|topic| topic.part(role));
        let all = part.into_iter().flat_map(move |part| part.by_entity.range((first, Bound::Unbounded)));
        distinct(all.map(|(place, _)| place))
    }

    /// Those of an entity's registrations that end with its attachment to a switch.
    pub fn bound_of(&self, entity: &Name, switch: &Name, names: &BTreeSet<Key>) -> Vec<(Key, NameRole)> {
        let each = names.iter().flat_map(|name| NameRole::ALL.map(|role| (*name, role)));
        each.filter(|(name, role)| self.get_at(name, entity, *role, switch).is_some_and(|r| r.bound)).collect()
    }

    /// All registrations through one switch.
    pub fn registered_at(&self, switch: &Name) -> Vec<(Key, Name, NameRole)> {
        let mut found = Vec::new();
        for (name, topic) in &self.0 {
            for role in NameRole::ALL {
                found.extend(topic.part(role).at(switch).map(|entity| (*name, *entity, role)));
            }
        }
        found
    }

    /// The registrations of a name that do not hold any more: of whom, as what, at which switch.
    pub fn revoked(&self, name: &Key, revocation: &Revocation) -> Vec<(Name, NameRole, Name)> {
        let all = self.0.get(name).into_iter().flat_map(|topic| topic.parts.iter().flat_map(|part| &part.by_entity));
        let holds = |r: &Registration| r.serials.iter().all(|(what, serial)| revocation.check(what, *serial).is_ok());
        all.filter(|(_, r)| !holds(r)).map(|((entity, switch), r)| (*entity, r.role, *switch)).collect()
    }

    /// The switches whose route changes because registrations of the name `at` this switch did.
    ///
    /// There are no routes unless somebody publishes the name and somebody subscribes to it. One more taker at a switch concerns that
    /// switch alone; the first or the last one there also those of the senders.
    pub fn reroute(&mut self, name: &Key, at: &Name, bit: impl Fn(&Name) -> Option<u8>) -> BTreeSet<Name> {
        let mut affected = BTreeSet::from([*at]);
        let Some(topic) = self.0.get_mut(name) else { return affected };
        let (senders, takers) = (topic.part(NameRole::Publisher), topic.part(NameRole::Subscriber));
        let takers_at = takers.by_switch.keys().filter_map(bit);
        let now = if senders.is_empty() { 0 } else { takers_at.fold(0, |bits, bit| bits | 1 << bit) };
        match (topic.egress_bits, now) {
            (before, now) if before == now => {}
            (0, _) | (_, 0) => affected.extend(topic.switches()),
            _ => affected.extend(senders.by_switch.keys()),
        }
        topic.egress_bits = now;
        affected
    }

    /// The route of a name at one switch, if it needs any.
    pub fn route(&self, name: &Key, switch: &Name) -> Option<Route> {
        self.0.get(name)?.route(name, switch)
    }

    /// The records of the names that begin so and lie behind `after`, as far as one message holds them.
    pub fn query(&self, now: Duration, prefix: &NamePrefix, after: Option<&RecordPlace>) -> Response {
        let padded: Option<Name> = format!("{:0<64}", prefix.as_str()).parse().ok();
        let begin = padded.unwrap_or_default();
        let matching = self.behind(after, begin).take_while(|(name, ..)| prefix.matches(name));
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

    /// At most `limit` records behind `after`, and whether there are more.
    pub fn records(&self, now: Duration, after: Option<&RecordPlace>, limit: usize) -> (Vec<Record>, bool) {
        let mut rest = self.behind(after, Name::default());
        let records = rest.by_ref().take(limit);
        let records = records.map(|(name, topic, registration)| registration.record(now, name, topic.proof)).collect();
        (records, rest.next().is_some())
    }

    /// All registrations of names from `begin` on and behind `after`, in the order of their places.
    fn behind<'a>(
        &'a self,
        after: Option<&RecordPlace>,
        begin: Name,
    ) -> impl Iterator<Item = (Name, &'a Topic, &'a Registration)> {
        let after = after.copied();
        let from = after.map_or(begin, |after| after.name.max(begin)).to_bytes();
        self.0.range(from..).flat_map(move |(key, topic)| {
            let name = Name::from_bytes(*key);
            let after = after.filter(|after| after.name == name);
            NameRole::ALL.into_iter().flat_map(move |role| {
                let first = match after {
                    Some(after) if role < after.role => None,
                    Some(after) if role == after.role => Some(Bound::Excluded((after.entity, after.switch))),
                    _ => Some(Bound::Unbounded),
                };
                let listed = first.map(|first| topic.part(role).by_entity.range((first, Bound::Unbounded)));
                listed.into_iter().flatten().map(move |(_, registration)| (name, topic, registration))
            })
        })
    }
}

impl Topic {
    fn part(&self, role: NameRole) -> &Registrations {
        &self.parts[role as usize]
    }

    fn part_mut(&mut self, role: NameRole) -> &mut Registrations {
        &mut self.parts[role as usize]
    }

    /// Where anybody has a part in the name; some several times.
    fn switches(&self) -> impl Iterator<Item = &Name> {
        self.parts.iter().flat_map(|part| part.by_switch.keys())
    }

    fn route(&self, name: &Key, switch: &Name) -> Option<Route> {
        let (senders, takers) = (self.part(NameRole::Publisher), self.part(NameRole::Subscriber));
        let writers: Vec<Name> = senders.at(switch).copied().collect();
        let locals: Vec<Name> = takers.at(switch).copied().collect();
        let is_everywhere = |entity: &&Name| takers.by_entity.get(&(**entity, *switch)).is_some_and(|r| r.everywhere);
        let everywhere: Vec<Name> = locals.iter().filter(is_everywhere).copied().collect();
        if self.egress_bits == 0 || writers.is_empty() && locals.is_empty() {
            return None;
        }
        let egress_bits = if writers.is_empty() { 0 } else { self.egress_bits };
        Some(Route { name: Name::from_bytes(*name), egress_bits, locals, everywhere, writers })
    }
}

impl Registrations {
    fn is_empty(&self) -> bool {
        self.by_entity.is_empty()
    }

    fn insert(&mut self, entity: Name, new: Registration) -> Option<Registration> {
        let old = self.remove(&entity, &new.switch);
        self.by_switch.entry(new.switch).or_default().insert(entity);
        self.by_entity.insert((entity, new.switch), new);
        old
    }

    fn entities(&self) -> impl Iterator<Item = Name> {
        distinct(self.by_entity.keys())
    }

    /// What an entity has stated, at each of its switches.
    fn of(&self, entity: &Name) -> impl Iterator<Item = &Registration> {
        let places = (*entity, Name::default())..=(*entity, LAST);
        self.by_entity.range(places).map(|(_, registration)| registration)
    }

    fn remove(&mut self, entity: &Name, switch: &Name) -> Option<Registration> {
        let old = self.by_entity.remove(&(*entity, *switch))?;
        if let Some(here) = self.by_switch.get_mut(&old.switch) {
            here.remove(entity);
            if here.is_empty() {
                self.by_switch.remove(&old.switch);
            }
        }
        Some(old)
    }

    fn at(&self, switch: &Name) -> impl Iterator<Item = &Name> {
        self.by_switch.get(switch).into_iter().flatten()
    }
}

/// Each entity once, of places in order.
fn distinct<'a>(places: impl Iterator<Item = &'a (Name, Name)>) -> impl Iterator<Item = Name> {
    let mut before = None;
    places.filter_map(move |(entity, _)| (before.replace(*entity) != Some(*entity)).then_some(*entity))
}
