//! Selects the border links by which other domains are reached. Pure state: the RIB sets the links
//! and queries where the frames of a name leave and where they may arrive.
//!
//! Frames to a domain leave by one link only, so that nothing arrives twice. That is the cheapest
//! link; between links of equal cost, a hash of the name decides. The other domain chooses by its
//! own costs and notices changes at its own time. Its frames may therefore arrive by any link
//! between the two, and for a while by links that were just removed.

use crate::rib::model::{At, Realm};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_wire::Name;
use gdp_wire::siphash::siphash24;

use super::bits::Bits;
use crate::rib::model::NameBytes;

/// Grace period after a link is removed or added, until the other domain has noticed.
///
/// Meanwhile frames may still arrive by the removed link, and the new link is used only where no
/// established one exists.
pub(super) const GRACE: Duration = Duration::from_secs(2);

#[derive(Clone, Debug, Default)]
pub(super) struct BorderLinks {
    /// Current links by neighbouring domain.
    present: BTreeMap<Name, Vec<BorderLink>>,
    /// Removed links (border, peer) by domain, and the time until which frames may arrive by them.
    earlier: BTreeMap<Name, BTreeMap<(Name, Name), Duration>>,
    /// New links (border, peer) by domain, and the time until which they count as new.
    fresh: BTreeMap<Name, BTreeMap<(Name, Name), Duration>>,
}

/// Changed domains, each with the borders that have or had links to it.
pub(super) type Changed = BTreeMap<Name, BTreeSet<Name>>;

impl BorderLinks {
    /// Replaces all links, of which only the `most` cheapest of each domain count.
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

    /// Ends the grace periods of removed and new links that are over at `now`.
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

    /// Returns the domains with links at this border.
    pub fn domains_over(&self, border: &Name) -> BTreeSet<Name> {
        let over = self.present.iter().filter(|(_, ways)| ways.iter().any(|way| way.border == *border));
        over.map(|(domain, _)| *domain).collect()
    }

    /// Returns the borders that send frames to the realm's entities or receive frames from them.
    pub fn borders(&self, realm: &Realm) -> BTreeSet<Name> {
        self.arrivals(realm).map(|(border, _)| border).collect()
    }

    /// Returns the links (border, peer) by which frames of the realm's entities may arrive. Some
    /// occur twice.
    pub fn arrivals(&self, realm: &Realm) -> impl Iterator<Item = (Name, Name)> {
        let domains = [Some(realm.domain), Some(realm.next).filter(|next| *next != realm.domain)];
        domains.into_iter().flatten().flat_map(|domain| {
            let present = self.present.get(&domain).into_iter().flatten().map(|way| (way.border, way.peer));
            present.chain(self.earlier.get(&domain).into_iter().flat_map(|earlier| earlier.keys().copied()))
        })
    }

    /// Returns the link by which frames to the name leave for the realm.
    ///
    /// Prefers an established link over a new one, then a direct link to the realm's domain over
    /// one to its neighbour.
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

/// Hashes a name and a link to the same value at both ends of the link. If their costs agree, both
/// ends elect the same link.
fn weight(name: &NameBytes, way: &BorderLink) -> u64 {
    let ends = (way.border.min(way.peer), way.border.max(way.peer));
    let bytes = [*name, ends.0.to_bytes(), ends.1.to_bytes()];
    let (words, _) = bytes.as_flattened().as_chunks();
    let words: [u64; 12] = std::array::from_fn(|i| u64::from_le_bytes(words[i]));
    siphash24([0; 2], &words)
}

/// Egress bits and border links from which routes are computed.
#[derive(Clone, Copy)]
pub(super) struct Map<'a> {
    pub bits: &'a Bits,
    pub ways: &'a BorderLinks,
}

impl Map<'_> {
    /// Returns the egress bit set by which frames to the name reach `at`, or 0 if there is no path.
    pub fn bits_to(self, name: &NameBytes, at: &At) -> u64 {
        let switch = match at {
            At::Here(switch) => Some(*switch),
            At::RemoteRegistrations(realm) => self.ways.elect(name, realm, self.bits).map(|way| way.border),
        };
        switch.and_then(|switch| self.bits.of(&switch)).map_or(0, |bit| 1 << bit)
    }

    /// Returns the peer to which this border sends the name's frames for the realm, if it is
    /// elected.
    pub fn leaves_to(self, name: &NameBytes, realm: &Realm, border: &Name) -> Option<Name> {
        self.ways.elect(name, realm, self.bits).filter(|way| way.border == *border).map(|way| way.peer)
    }

    /// Returns the peers from which frames of the realm's entities arrive at this border.
    pub fn arrives_from(self, realm: &Realm, border: &Name) -> impl Iterator<Item = Name> {
        self.ways.arrivals(realm).filter(move |(at, _)| at == border).map(|(_, peer)| peer)
    }

    /// Returns the switches whose routes depend on an entity at `at`.
    pub fn switches(self, at: &At) -> BTreeSet<Name> {
        match at {
            At::Here(switch) => BTreeSet::from([*switch]),
            At::RemoteRegistrations(realm) => self.ways.borders(realm),
        }
    }
}

/// Link of a border switch into another domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BorderLink {
    /// Switch of this domain.
    pub border: Name,
    /// Switch at the other end.
    pub peer: Name,
    pub cost: u32,
}
