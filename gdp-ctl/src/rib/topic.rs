//! One name: those who have a part in it, and where it is therefore routed. What is registered and the [`Map`] go in, routes come
//! out. Called by [`super::names`].

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;

use gdp::control::{NameRole, RecordPlace, Route};
use gdp::name::NameProof;
use gdp_wire::Name;

use super::names::{Key, Kind, LAST, Registration, meets};
use super::ways::{At, Map, Realm};

#[derive(Debug)]
pub(super) struct Topic {
    pub proof: NameProof,
    /// By role.
    parts: [Registrations; NameRole::ALL.len()],
    /// As of the last [`Topic::reroute`].
    spread: Spread,
}

/// Where frames to a name go.
#[derive(Debug, Default, PartialEq, Eq)]
struct Spread {
    /// By the switches at which they come in: all that send, or where what is sent abroad may come in.
    egress: BTreeMap<Name, u64>,
    /// Those who send and those who take what is sent, if the name concerns other domains; within one all send to all.
    met: Option<[BTreeSet<Kind>; 2]>,
}

impl Spread {
    /// Whether those of this kind send to anybody.
    fn has_sender(&self, kind: impl FnOnce() -> Kind) -> bool {
        self.met.as_ref().is_none_or(|[senders, _]| senders.contains(&kind()))
    }

    /// Whether anybody sends to those of this kind.
    fn has_taker(&self, kind: impl FnOnce() -> Kind) -> bool {
        self.met.as_ref().is_none_or(|[_, takers]| takers.contains(&kind()))
    }
}

impl Topic {
    pub fn new(proof: NameProof) -> Self {
        Self { proof, parts: Default::default(), spread: Spread::default() }
    }

    pub fn part(&self, role: NameRole) -> &Registrations {
        &self.parts[role as usize]
    }

    pub fn part_mut(&mut self, role: NameRole) -> &mut Registrations {
        &mut self.parts[role as usize]
    }

    /// Whether somebody takes the name, and nobody sends to it.
    pub fn is_unserved(&self) -> bool {
        let has = |roles: [NameRole; 2]| roles.iter().any(|role| !self.part(*role).is_empty());
        has([NameRole::Subscriber, NameRole::Caller]) && !has([NameRole::Publisher, NameRole::Server])
    }

    pub fn parts(&self) -> impl Iterator<Item = &Registrations> {
        self.parts.iter()
    }

    pub fn places(&self, name: Name) -> impl Iterator<Item = RecordPlace> {
        let of = move |role| self.part(role).iter().map(move |((entity, switch), _)| (role, *entity, *switch));
        let all = NameRole::ALL.into_iter().flat_map(of);
        all.map(move |(role, entity, switch)| RecordPlace { name, role, entity, switch })
    }

    /// Whether somebody publishes the name and somebody reads it. A service is not routed: its servers and callers send to each other's
    /// own names.
    pub fn is_routed(&self) -> bool {
        !self.spread.egress.is_empty()
    }

    /// Where anybody has a part in the name, or is reached by.
    pub fn switches(&self, map: Map) -> BTreeSet<Name> {
        let here = self.parts.iter().flat_map(|part| part.by_switch.keys().copied());
        let borders = self.parts.iter().flat_map(|part| part.by_realm.keys()).flat_map(|realm| map.ways.borders(realm));
        here.chain(borders).collect()
    }

    /// The switches whose route changes because registrations `at` these switches did, or ways over them.
    ///
    /// There are no routes unless somebody publishes the name and somebody reads it. One more taker at a switch concerns that
    /// switch alone; the first or the last one there also those where frames come in.
    pub fn reroute(&mut self, name: &Key, at: BTreeSet<Name>, map: Map) -> BTreeSet<Name> {
        let spread = self.spread(name, map);
        let before = std::mem::replace(&mut self.spread, spread);
        let mut affected = at;
        let now = &self.spread;
        if before.egress.is_empty() != now.egress.is_empty() || before.met != now.met {
            affected.extend(self.switches(map));
        }
        let changed = |(switch, bits): &(&Name, &u64)| now.egress.get(switch) != Some(bits);
        affected.extend(before.egress.iter().filter(changed).map(|(switch, _)| *switch));
        affected.extend(now.egress.keys().filter(|switch| !before.egress.contains_key(switch)));
        affected
    }

    fn spread(&self, name: &Key, map: Map) -> Spread {
        let (senders, takers) = (self.part(NameRole::Publisher), self.part(NameRole::Subscriber));
        if senders.by_realm.is_empty() && takers.by_realm.is_empty() {
            let bits = takers.by_switch.keys().fold(0, |bits, switch| bits | map.bits_to(name, &At::Here(*switch)));
            let switches = senders.by_switch.keys().filter(|_| bits != 0);
            return Spread { egress: switches.map(|switch| (*switch, bits)).collect(), met: None };
        }
        let mut bits: BTreeMap<Kind, u64> = BTreeMap::new();
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
        Spread { egress, met: Some(met) }
    }

    pub fn route(&self, name: &Key, switch: &Name, map: Map) -> Option<Route> {
        if !self.is_routed() {
            return None;
        }
        let (senders, takers) = (self.part(NameRole::Publisher), self.part(NameRole::Subscriber));
        let is_sender = |(_, registration): &(Name, &Registration)| self.spread.has_sender(|| registration.kind());
        let is_taker = |(_, registration): &(Name, &Registration)| self.spread.has_taker(|| registration.kind());
        let sent_from = |realm| senders.in_realm(realm).any(|registration| is_sender(&registration));
        let taken_in = |realm| takers.in_realm(realm).any(|registration| is_taker(&registration));
        let mut writers: BTreeSet<Name> = senders.at(switch).filter(is_sender).map(|(entity, _)| entity).collect();
        let from_abroad = senders.by_realm.keys().filter(|realm| sent_from(realm));
        writers.extend(from_abroad.flat_map(|realm| map.arrives_from(realm, switch)));
        let here: BTreeMap<Name, &Registration> = takers.at(switch).filter(is_taker).collect();
        let everywhere = here.iter().filter(|(_, taker)| taker.everywhere).map(|(entity, _)| *entity).collect();
        let mut locals: BTreeSet<Name> = here.into_keys().collect();
        let to_abroad = takers.by_realm.keys().filter(|realm| taken_in(realm));
        locals.extend(to_abroad.filter_map(|realm| map.leaves_to(name, realm, switch)));
        if writers.is_empty() && locals.is_empty() {
            return None;
        }
        let egress_bits = if writers.is_empty() { 0 } else { self.spread.egress.get(switch).copied().unwrap_or(0) };
        let (locals, writers) = (locals.into_iter().collect(), writers.into_iter().collect());
        Some(Route { name: Name::from_bytes(*name), egress_bits, locals, everywhere, writers, ..Route::default() })
    }
}

/// Those who have one role in a name; an entity as often as it has stated it at different switches.
#[derive(Debug, Default)]
pub(super) struct Registrations {
    /// And by switch.
    by_entity: BTreeMap<(Name, Name), Registration>,
    /// Entities of this domain.
    by_switch: BTreeMap<Name, BTreeSet<Name>>,
    /// Entities of others, with their switches.
    by_realm: BTreeMap<Realm, BTreeSet<(Name, Name)>>,
}

impl Registrations {
    pub fn is_empty(&self) -> bool {
        self.by_entity.is_empty()
    }

    pub fn insert(&mut self, entity: Name, new: Registration) -> Option<Registration> {
        let old = self.remove(&entity, &new.switch);
        match new.at() {
            At::Here(switch) => self.by_switch.entry(switch).or_default().insert(entity),
            At::Abroad(realm) => self.by_realm.entry(realm).or_default().insert((entity, new.switch)),
        };
        self.by_entity.insert((entity, new.switch), new);
        old
    }

    pub fn remove(&mut self, entity: &Name, switch: &Name) -> Option<Registration> {
        let old = self.by_entity.remove(&(*entity, *switch))?;
        match old.at() {
            At::Here(switch) => take_out(&mut self.by_switch, &switch, entity),
            At::Abroad(realm) => take_out(&mut self.by_realm, &realm, &(*entity, *switch)),
        }
        Some(old)
    }

    pub fn get(&self, entity: &Name, switch: &Name) -> Option<&Registration> {
        self.by_entity.get(&(*entity, *switch))
    }

    /// By entity and switch.
    pub fn iter(&self) -> impl Iterator<Item = (&(Name, Name), &Registration)> {
        self.by_entity.iter()
    }

    /// Those from this place on.
    pub fn behind(&self, first: Bound<(Name, Name)>) -> impl Iterator<Item = (&(Name, Name), &Registration)> {
        self.by_entity.range((first, Bound::Unbounded))
    }

    pub fn entities(&self) -> impl Iterator<Item = Name> {
        distinct(self.by_entity.keys())
    }

    /// What an entity has stated, at each of its switches.
    pub fn of(&self, entity: &Name) -> impl Iterator<Item = &Registration> {
        let places = (*entity, Name::default())..=(*entity, LAST);
        self.by_entity.range(places).map(|(_, registration)| registration)
    }

    /// The entities at a switch of this domain.
    pub fn at(&self, switch: &Name) -> impl Iterator<Item = (Name, &Registration)> {
        let entities = self.by_switch.get(switch).into_iter().flatten();
        let switch = *switch;
        entities.filter_map(move |entity| Some((*entity, self.by_entity.get(&(*entity, switch))?)))
    }

    pub fn count_at(&self, at: &At) -> usize {
        match at {
            At::Here(switch) => self.by_switch.get(switch).map_or(0, BTreeSet::len),
            At::Abroad(realm) => self.by_realm.get(realm).map_or(0, BTreeSet::len),
        }
    }

    fn in_realm(&self, realm: &Realm) -> impl Iterator<Item = (Name, &Registration)> {
        let places = self.by_realm.get(realm).into_iter().flatten();
        places.filter_map(|place| Some((place.0, self.by_entity.get(place)?)))
    }

    /// Each kind there is at a place, once.
    fn kinds(&self) -> impl Iterator<Item = (At, Kind)> {
        let all: BTreeSet<(At, Kind)> = self.by_entity.values().map(|r| (r.at(), r.kind())).collect();
        all.into_iter()
    }
}

fn take_out<K: Ord, V: Ord>(sets: &mut BTreeMap<K, BTreeSet<V>>, key: &K, value: &V) {
    if let Some(set) = sets.get_mut(key) {
        set.remove(value);
        if set.is_empty() {
            sets.remove(key);
        }
    }
}

/// Each entity once, of places in order.
pub(super) fn distinct<'a>(places: impl Iterator<Item = &'a (Name, Name)>) -> impl Iterator<Item = Name> {
    let mut before = None;
    places.filter_map(move |(entity, _)| (before.replace(*entity) != Some(*entity)).then_some(*entity))
}
