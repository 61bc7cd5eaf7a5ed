//! By which borders other domains are reached. Pure; the RIB fills it from what it is told, and
//! asks where a name leaves and where it may come in.
//!
//! What is sent to a domain leaves by one way, so that nothing arrives twice: the cheapest, and of
//! several such one that differs from name to name. The other side chooses for itself, by its own
//! costs and when it notices changes; so what comes from there may come by any of the ways between
//! the two, and for a while by those that have just gone.

use crate::rib::model::{At, Realm};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_wire::Name;
use gdp_wire::siphash::siphash24;

use super::bits::Bits;
use crate::rib::model::NameBytes;

/// How long frames may come by a way that is no more, and before what can leave by another leaves
/// by a new one: until the other side has noticed, too.
pub(super) const GRACE: Duration = Duration::from_secs(2);

#[derive(Clone, Debug, Default)]
pub(super) struct BorderLinks {
    /// By neighbouring domain.
    present: BTreeMap<Name, Vec<BorderLink>>,
    /// Those that are no more, and until when they count: border and peer.
    earlier: BTreeMap<Name, BTreeMap<(Name, Name), Duration>>,
    /// Those that are new, and until when.
    fresh: BTreeMap<Name, BTreeMap<(Name, Name), Duration>>,
}

/// What has changed: domains, and the borders that have, or had, ways to them.
pub(super) type Changed = BTreeMap<Name, BTreeSet<Name>>;

impl BorderLinks {
    /// Of each domain at most `most` count, the cheapest.
    pub fn set(&mut self, now: Duration, ways: BTreeMap<Name, Vec<BorderLink>>, most: usize) -> Changed {
        let mut ways: BTreeMap<Name, Vec<BorderLink>> = ways.into_iter().filter(|(_, ways)| !ways.is_empty()).collect();
        for ways in ways.values_mut() {
            ways.sort_unstable_by_key(|way| (way.cost, way.border, way.peer));
            ways.truncate(most);
        }
        let before = std::mem::replace(&mut self.present, ways);
        let domains: BTreeSet<Name> = before.keys().chain(self.present.keys()).copied().collect();
        let mut changed = Changed::new();
        for domain in domains {
            let (old, new) = (before.get(&domain), self.present.get(&domain));
            if old == new {
                continue;
            }
            let both = || old.into_iter().chain(new).flatten();
            changed.insert(domain, both().map(|way| way.border).collect());
            let links = |ways: Option<&Vec<BorderLink>>| -> BTreeSet<(Name, Name)> {
                ways.into_iter().flatten().map(|way| (way.border, way.peer)).collect()
            };
            let (old, new) = (links(old), links(new));
            let earlier = self.earlier.entry(domain).or_default();
            earlier.extend(old.difference(&new).map(|link| (*link, now + GRACE)));
            earlier.retain(|link, _| !new.contains(link));
            let fresh = self.fresh.entry(domain).or_default();
            fresh.extend(new.difference(&old).map(|link| (*link, now + GRACE)));
            fresh.retain(|link, _| new.contains(link));
        }
        changed
    }

    /// Forgets which ways were there earlier, and which were new.
    pub fn end(&mut self, now: Duration) -> Changed {
        let mut changed = Changed::new();
        for (domain, links) in self.earlier.iter_mut().chain(&mut self.fresh) {
            let over = links.extract_if(.., |_, until| *until <= now).map(|((border, _), _)| border);
            let over: BTreeSet<Name> = over.collect();
            if !over.is_empty() {
                changed.entry(*domain).or_default().extend(over);
            }
        }
        self.earlier.retain(|_, links| !links.is_empty());
        self.fresh.retain(|_, links| !links.is_empty());
        changed
    }

    /// The domains with ways over this border.
    pub fn domains_over(&self, border: &Name) -> BTreeSet<Name> {
        let over = self.present.iter().filter(|(_, ways)| ways.iter().any(|way| way.border == *border));
        over.map(|(domain, _)| *domain).collect()
    }

    /// Borders by which entities of the realm send or are sent to.
    pub fn borders(&self, realm: &Realm) -> BTreeSet<Name> {
        self.arrivals(realm).map(|(border, _)| border).collect()
    }

    /// The ways by which frames of the realm's entities may come: border and peer; some twice.
    pub fn arrivals(&self, realm: &Realm) -> impl Iterator<Item = (Name, Name)> {
        let domains = [Some(realm.domain), Some(realm.next).filter(|next| *next != realm.domain)];
        domains.into_iter().flatten().flat_map(|domain| {
            let present = self.present.get(&domain).into_iter().flatten().map(|way| (way.border, way.peer));
            present.chain(self.earlier.get(&domain).into_iter().flat_map(|earlier| earlier.keys().copied()))
        })
    }

    /// The way by which what is sent to the name leaves for the realm: a direct one, if there is
    /// any.
    fn elect(&self, name: &NameBytes, realm: &Realm, bits: &Bits) -> Option<&BorderLink> {
        let best = |(is_fresh, domain): (bool, &Name)| {
            let ways = self.present.get(domain)?.iter().filter(|way| bits.of(&way.border).is_some());
            let ways = ways.filter(|way| self.is_fresh(domain, way) == is_fresh);
            ways.min_by_key(|way| (way.cost, Reverse(weight(name, way)), way.border, way.peer))
        };
        let known = [(false, &realm.domain), (false, &realm.next)];
        known.into_iter().chain([(true, &realm.domain), (true, &realm.next)]).find_map(best)
    }

    fn is_fresh(&self, domain: &Name, way: &BorderLink) -> bool {
        self.fresh.get(domain).is_some_and(|fresh| fresh.contains_key(&(way.border, way.peer)))
    }
}

/// The same at both ends of a link: as far as costs are alike there, both choose the same one.
fn weight(name: &NameBytes, way: &BorderLink) -> u64 {
    let ends = (way.border.min(way.peer), way.border.max(way.peer));
    let bytes = [*name, ends.0.to_bytes(), ends.1.to_bytes()];
    let (words, _) = bytes.as_flattened().as_chunks();
    let words: [u64; 12] = std::array::from_fn(|i| u64::from_le_bytes(words[i]));
    siphash24([0; 2], &words)
}

/// What routes are computed from besides who is registered.
#[derive(Clone, Copy)]
pub(super) struct Map<'a> {
    pub bits: &'a Bits,
    pub ways: &'a BorderLinks,
}

impl Map<'_> {
    /// The egress bits of those there, for frames to the name; 0: there is no way.
    pub fn bits_to(self, name: &NameBytes, at: &At) -> u64 {
        let switch = match at {
            At::Here(switch) => Some(*switch),
            At::RemoteRegistrations(realm) => self.ways.elect(name, realm, self.bits).map(|way| way.border),
        };
        switch.and_then(|switch| self.bits.of(&switch)).map_or(0, |bit| 1 << bit)
    }

    /// To whom frames to the name leave for the realm at this border, if they do.
    pub fn leaves_to(self, name: &NameBytes, realm: &Realm, border: &Name) -> Option<Name> {
        self.ways.elect(name, realm, self.bits).filter(|way| way.border == *border).map(|way| way.peer)
    }

    /// From whom frames of the realm's entities come at this border.
    pub fn arrives_from(self, realm: &Realm, border: &Name) -> impl Iterator<Item = Name> {
        self.ways.arrivals(realm).filter(move |(at, _)| at == border).map(|(_, peer)| peer)
    }

    /// The switches whose routes it concerns what is there.
    pub fn switches(self, at: &At) -> BTreeSet<Name> {
        match at {
            At::Here(switch) => BTreeSet::from([*switch]),
            At::RemoteRegistrations(realm) => self.ways.borders(realm),
        }
    }
}

/// A link of a border switch into another domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BorderLink {
    /// This domain's switch.
    pub border: Name,
    /// The switch at the other end.
    pub peer: Name,
    pub cost: u32,
}
