//! Registrations of one name and where its frames go. Registrations and the [`Map`] go in, routes
//! come out. [`super::names`] calls it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::name::NameProof;
use gdp_proto::control::{NameRole, RecordKey, Route};
use gdp_wire::Name;

use super::border_links::Map;
use crate::rib::model::{At, NameBytes, Realm};
use crate::rib::registration::{EndpointScope, Registration, meets};

#[derive(Debug)]
pub(super) struct Topic {
    pub proof: NameProof,
    /// Registrations by role, most of them absent.
    parts: [Option<Box<Registrations>>; NameRole::ALL.len()],
    /// Result of the last [`Topic::reroute`]. `None` if the name is not routed.
    spread: Option<Box<Spread>>,
    /// Time of the next examination for expired registrations, at the latest when the first one
    /// ends.
    pub look_at: Duration,
}

/// Egress bits to which the frames of a name are sent.
#[derive(Debug, Default, PartialEq, Eq)]
struct Spread {
    /// Egress bits by ingress switch: switches of senders, and borders where frames from other
    /// domains may arrive.
    egress: BTreeMap<Name, u64>,
    /// Kinds of senders and of receivers with a counterpart, if the name concerns other domains.
    /// Within one domain all senders reach all receivers.
    met: Option<Box<[BTreeSet<EndpointScope>; 2]>>,
}

static NOWHERE: Spread = Spread { egress: BTreeMap::new(), met: None };

impl Spread {
    /// Returns whether senders of this kind have a receiver.
    fn has_sender(&self, kind: impl FnOnce() -> EndpointScope) -> bool {
        self.met.as_deref().is_none_or(|[senders, _]| senders.contains(&kind()))
    }

    /// Returns whether receivers of this kind have a sender.
    fn has_taker(&self, kind: impl FnOnce() -> EndpointScope) -> bool {
        self.met.as_deref().is_none_or(|[_, takers]| takers.contains(&kind()))
    }
}

impl Topic {
    pub fn new(proof: NameProof) -> Self {
        Self { proof, parts: Default::default(), spread: None, look_at: Duration::MAX }
    }

    pub fn part(&self, role: NameRole) -> &Registrations {
        static NONE: Registrations = Registrations { all: Vec::new(), by_location: Vec::new() };
        self.parts[role as usize].as_deref().unwrap_or(&NONE)
    }

    pub fn get_mut(&mut self, entity: &Name, role: NameRole, switch: &Name) -> Option<&mut Registration> {
        self.parts[role as usize].as_mut()?.get_mut(entity, switch)
    }

    pub fn insert(&mut self, new: Registration) -> Option<Registration> {
        self.parts[new.role as usize].get_or_insert_default().insert(new)
    }

    pub fn remove(&mut self, entity: &Name, role: NameRole, switch: &Name) -> Option<Registration> {
        let part = &mut self.parts[role as usize];
        let removed = part.as_mut()?.remove(entity, switch);
        part.take_if(|part| part.is_empty());
        removed
    }

    /// Returns whether the name has subscribers or callers, but no publisher or server.
    pub fn has_no_writer(&self) -> bool {
        let has = |roles: [NameRole; 2]| roles.iter().any(|role| !self.part(*role).is_empty());
        has([NameRole::Subscriber, NameRole::Caller]) && !has([NameRole::Publisher, NameRole::Server])
    }

    pub fn parts(&self) -> impl Iterator<Item = &Registrations> {
        self.parts.iter().flatten().map(Box::as_ref)
    }

    pub fn keys(&self, name: Name) -> impl Iterator<Item = RecordKey> {
        let of = move |role| self.part(role).iter().map(move |((entity, switch), _)| (role, entity, switch));
        let all = NameRole::ALL.into_iter().flat_map(of);
        all.map(move |(role, entity, switch)| RecordKey { name, role, entity, switch })
    }

    /// Returns whether the name has a publisher and a subscriber that can meet. Services are not
    /// routed: servers and callers send to each other's inboxes.
    pub fn is_routed(&self) -> bool {
        self.spread.is_some()
    }

    /// Returns the switches of all registrations and the borders that lead to them.
    pub fn switches(&self, map: Map) -> BTreeSet<Name> {
        let here = self.parts().flat_map(Registrations::switches);
        let borders = self.parts().flat_map(Registrations::realms).flat_map(|realm| map.ways.borders(&realm));
        here.chain(borders).collect()
    }

    /// Recomputes the routing of the name after registrations or border links at the switches `at`
    /// changed. Returns the switches whose route changes.
    ///
    /// Routes exist only if the name has a publisher and a subscriber. A further subscriber at a
    /// switch changes that switch alone. The first or last one there also changes the switches
    /// where frames enter.
    pub fn reroute(&mut self, name: &NameBytes, at: BTreeSet<Name>, map: Map) -> BTreeSet<Name> {
        let spread = Some(self.spread(name, map)).filter(|spread| !spread.egress.is_empty());
        let before = std::mem::replace(&mut self.spread, spread.map(Box::new));
        let mut affected = at;
        let (before, now) = (before.as_deref().unwrap_or(&NOWHERE), self.spread.as_deref().unwrap_or(&NOWHERE));
        if before.egress.is_empty() != now.egress.is_empty() || before.met != now.met {
            affected.extend(self.switches(map));
        }
        let changed = |(switch, bits): &(&Name, &u64)| now.egress.get(switch) != Some(bits);
        affected.extend(before.egress.iter().filter(changed).map(|(switch, _)| *switch));
        affected.extend(now.egress.keys().filter(|switch| !before.egress.contains_key(switch)));
        affected
    }

    fn spread(&self, name: &NameBytes, map: Map) -> Spread {
        let (senders, takers) = (self.part(NameRole::Publisher), self.part(NameRole::Subscriber));
        if !senders.reaches_other_domains() && !takers.reaches_other_domains() {
            let bits = takers.locations().fold(0, |bits, at| bits | map.bits_to(name, &at));
            let switches = senders.switches().filter(|_| bits != 0);
            return Spread { egress: switches.map(|switch| (switch, bits)).collect(), met: None };
        }
        let mut bits: BTreeMap<EndpointScope, u64> = BTreeMap::new();
        takers.kinds().for_each(|(at, kind)| *bits.entry(kind).or_default() |= map.bits_to(name, &at));
        bits.retain(|_, bits| *bits != 0);
        let (mut egress, mut met) = (BTreeMap::new(), [BTreeSet::new(), BTreeSet::new()]);
        for (at, kind) in senders.kinds() {
            for (taker, bits) in bits.iter().filter(|(taker, _)| meets(NameRole::Publisher, &kind, taker)) {
                for switch in map.switches(&at) {
                    *egress.entry(switch).or_default() |= bits;
                }
                met[0].insert(kind.clone());
                met[1].insert(taker.clone());
            }
        }
        Spread { egress, met: Some(Box::new(met)) }
    }

    pub fn route(&self, name: &NameBytes, switch: &Name, map: Map) -> Option<Route> {
        let spread = self.spread.as_deref()?;
        let (senders, takers) = (self.part(NameRole::Publisher), self.part(NameRole::Subscriber));
        let is_sender = |(_, registration): &(Name, &Registration)| spread.has_sender(|| registration.kind());
        let is_taker = |(_, registration): &(Name, &Registration)| spread.has_taker(|| registration.kind());
        let sent_from =
            |realm: &Realm| senders.at(&At::RemoteRegistrations(*realm)).any(|registration| is_sender(&registration));
        let taken_in =
            |realm: &Realm| takers.at(&At::RemoteRegistrations(*realm)).any(|registration| is_taker(&registration));
        let here = At::Here(*switch);
        let mut writers: BTreeSet<Name> = senders.at(&here).filter(is_sender).map(|(entity, _)| entity).collect();
        for realm in senders.realms().filter(sent_from) {
            writers.extend(map.arrives_from(&realm, switch));
        }
        let here: BTreeMap<Name, &Registration> = takers.at(&here).filter(is_taker).collect();
        let everywhere = here.iter().filter(|(_, taker)| taker.everywhere).map(|(entity, _)| *entity).collect();
        let mut locals: BTreeSet<Name> = here.into_keys().collect();
        let to_abroad = takers.realms().filter(taken_in);
        locals.extend(to_abroad.filter_map(|realm| map.leaves_to(name, &realm, switch)));
        if writers.is_empty() && locals.is_empty() {
            return None;
        }
        let egress_bits = if writers.is_empty() { 0 } else { spread.egress.get(switch).copied().unwrap_or(0) };
        let (locals, writers) = (locals.into_iter().collect(), writers.into_iter().collect());
        Some(Route { name: Name::from_bytes(*name), egress_bits, locals, everywhere, writers, ..Route::default() })
    }
}

/// Registrations for one role of a name, one for each entity and switch. Most names have one, some
/// have thousands. The layout stores only what is needed to find them.
#[derive(Debug, Default)]
pub(super) struct Registrations {
    /// Registrations ordered by entity, then switch.
    #[expect(clippy::vec_box, reason = "of thousands, half are moved by an insertion")]
    all: Vec<Box<Registration>>,
    /// Indices into `all`, ordered by location, then entity.
    by_location: Vec<u32>,
}

impl Registrations {
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    fn insert(&mut self, new: Registration) -> Option<Registration> {
        let (place, at) = (new.entity_and_switch(), new.at());
        let old = self.remove(&place.0, &place.1);
        let index = self.all.partition_point(|held| held.entity_and_switch() < place);
        insert(&mut self.all, index, Box::new(new));
        let index = index as u32;
        self.by_location.iter_mut().filter(|held| **held >= index).for_each(|held| *held += 1);
        let rank = self.by_location.partition_point(|held| (self.location(*held), *held) < (at, index));
        insert(&mut self.by_location, rank, index);
        old
    }

    fn remove(&mut self, entity: &Name, switch: &Name) -> Option<Registration> {
        let index = self.find(entity, switch)?;
        let removed = index as u32;
        self.by_location.retain(|held| *held != removed);
        self.by_location.iter_mut().filter(|held| **held > removed).for_each(|held| *held -= 1);
        Some(*self.all.remove(index))
    }

    fn find(&self, entity: &Name, switch: &Name) -> Option<usize> {
        self.all.binary_search_by(|held| held.entity_and_switch().cmp(&(*entity, *switch))).ok()
    }

    fn location(&self, index: u32) -> At {
        self.all[index as usize].at()
    }

    pub fn get(&self, entity: &Name, switch: &Name) -> Option<&Registration> {
        self.find(entity, switch).map(|index| &*self.all[index])
    }

    fn get_mut(&mut self, entity: &Name, switch: &Name) -> Option<&mut Registration> {
        self.find(entity, switch).map(|index| &mut *self.all[index])
    }

    /// Iterates over the registrations, ordered by entity and switch.
    pub fn iter(&self) -> impl Iterator<Item = ((Name, Name), &Registration)> {
        self.all.iter().map(|registration| (registration.entity_and_switch(), &**registration))
    }

    /// Iterates over the registrations after a given entity and switch, or over all.
    pub fn behind(&self, after: Option<(Name, Name)>) -> impl Iterator<Item = ((Name, Name), &Registration)> {
        let first = after.map_or(0, |after| self.all.partition_point(|held| held.entity_and_switch() <= after));
        self.all[first..].iter().map(|registration| (registration.entity_and_switch(), &**registration))
    }

    pub fn entities(&self) -> impl Iterator<Item = Name> {
        distinct(self.iter().map(|(place, _)| place))
    }

    /// Iterates over the registrations of an entity at each of its switches.
    pub fn of(&self, entity: &Name) -> impl Iterator<Item = &Registration> {
        let (first, entity) = (self.all.partition_point(|held| held.by.name < *entity), *entity);
        self.all[first..].iter().take_while(move |held| held.by.name == entity).map(Box::as_ref)
    }

    /// Iterates over the entities at a location.
    pub fn at(&self, at: &At) -> impl Iterator<Item = (Name, &Registration)> {
        self.indices_at(at).iter().map(|index| {
            let registration = &*self.all[*index as usize];
            (registration.by.name, registration)
        })
    }

    pub fn count_at(&self, at: &At) -> usize {
        self.indices_at(at).len()
    }

    fn indices_at(&self, at: &At) -> &[u32] {
        let first = self.by_location.partition_point(|held| self.location(*held) < *at);
        let rest = &self.by_location[first..];
        &rest[..rest.partition_point(|held| self.location(*held) == *at)]
    }

    /// Iterates over the distinct locations, those of this domain first.
    fn locations(&self) -> impl Iterator<Item = At> {
        let mut rest = &self.by_location[..];
        std::iter::from_fn(move || {
            let at = self.location(*rest.first()?);
            rest = &rest[rest.partition_point(|held| self.location(*held) == at)..];
            Some(at)
        })
    }

    fn switches(&self) -> impl Iterator<Item = Name> {
        self.locations().map_while(|at| if let At::Here(switch) = at { Some(switch) } else { None })
    }

    fn realms(&self) -> impl Iterator<Item = Realm> {
        let abroad = self.reaches_other_domains();
        let places = abroad.then(|| self.locations()).into_iter().flatten();
        places.filter_map(|at| if let At::RemoteRegistrations(realm) = at { Some(realm) } else { None })
    }

    fn reaches_other_domains(&self) -> bool {
        self.by_location.last().is_some_and(|last| matches!(self.location(*last), At::RemoteRegistrations(_)))
    }

    /// Iterates over the distinct kinds at each location.
    fn kinds(&self) -> impl Iterator<Item = (At, EndpointScope)> {
        let all: BTreeSet<(At, EndpointScope)> = self.all.iter().map(|r| (r.at(), r.kind())).collect();
        all.into_iter()
    }
}

/// Inserts like [`Vec::insert`], but allocates room for one element instead of four at first.
fn insert<T>(all: &mut Vec<T>, index: usize, new: T) {
    if all.is_empty() {
        all.reserve_exact(1);
    }
    all.insert(index, new);
}

/// Returns each entity of an ordered list of (entity, switch) once.
pub(super) fn distinct(places: impl Iterator<Item = (Name, Name)>) -> impl Iterator<Item = Name> {
    let mut before = None;
    places.filter_map(move |(entity, _)| (before.replace(entity) != Some(entity)).then_some(entity))
}
