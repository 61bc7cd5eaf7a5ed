//! Translates this switch's FIB, which has names, into the data planes' tables, which have links.
//! Sans-IO.
//!
//! Inputs are pushes of the RIB, paths of the topology, and links that come and go. Outputs are
//! changes of the data-plane tables.
//!
//! There are two layers. The known layer has the routes that the current RIB has sent since it
//! started. The stale layer has the routes of an earlier daemon or RIB. Stale routes count as well,
//! until the RIB withdraws them or sends a complete, settled FIB. Known paths come from the
//! topology. Stale paths are those by which an earlier daemon forwarded.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use gdp_link::link::KeyedEntry;
use gdp_proto::control::{Extent, FibPush, OwnName, Route};
use gdp_wire::table::{ANY_WRITER, EGRESS_SET_SIZE};
use gdp_wire::{LinkRole, Name};

use super::ends::Ends;
use gdp_dataplane::{Left, PlaneRoute};
use gdp_rib::topology::Paths;

/// One change of the data-plane tables. Changes apply in order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlaneChange {
    /// This switch's own egress bit, as a mask.
    OwnBit(u64),
    /// The egress switches that the neighbour on this link reaches, as a mask.
    Reach {
        link: u32,
        bits: u64,
    },
    NextHops(Box<[u32; EGRESS_SET_SIZE as usize]>),
    Set(Name, PlaneRoute),
    Remove(Name),
}

/// A push that does not follow the last generation. The switch needs the whole FIB.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the switch has generation {current}, so it cannot apply a change to generation {got}; send the whole FIB")]
pub struct OutOfStep {
    pub current: u64,
    pub got: u64,
}

/// The FIB by name, and the links of the peers in it.
#[derive(Debug, Default)]
pub struct Routes {
    own_bit: Option<u8>,
    /// Whether another switch owns this switch's egress bit, according to the topology.
    bit_is_lost: bool,
    known: Layer,
    stale: Layer,
    /// The RIB run that sent the known layer.
    run: Option<u64>,
    generation: u64,
    /// The names that a full transfer has not confirmed yet, and the number of its next part.
    sweep: Option<(HashSet<Name>, u32)>,
    switches: HashMap<Name, Ends>,
    endpoints: HashMap<Name, Ends>,
    /// The border switches of other domains.
    borders: HashMap<Name, Ends>,
    /// The names that each local endpoint reads or writes, and those that concern each adjacent
    /// border.
    concerned: HashMap<Name, BTreeSet<Name>>,
}

#[derive(Debug, Default)]
struct Layer {
    /// The egress bits that each neighbour reaches.
    reach: BTreeMap<Name, u64>,
    routes: HashMap<Name, Way>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Way {
    route: Route,
    /// Whether any endpoint may send to the name under its own identity, because the writers are
    /// unknown.
    anyone: bool,
}

impl Routes {
    /// Adopts the routes of an earlier daemon as stale. `links` are its remaining links.
    pub fn adopt(&mut self, left: &Left, links: &[(KeyedEntry, LinkRole)]) -> Vec<PlaneChange> {
        self.own_bit = (left.own_bit != 0).then(|| left.own_bit.trailing_zeros() as u8);
        let peers: HashMap<u32, (Name, LinkRole)> =
            links.iter().map(|(link, role)| (link.id, (link.peer, *role))).collect();
        let sent_on: HashSet<u32> =
            left.routes.iter().flat_map(|(_, route)| &route.readers).chain(&left.next_hops).copied().collect();
        let (used, unused): (Vec<_>, Vec<_>) = links.iter().partition(|(link, _)| sent_on.contains(&link.id));
        for (link, role) in unused.into_iter().chain(used) {
            self.ends(*role).entry(link.peer).or_default().adopt(link.lane as u8, link.id);
        }
        for (bit, link) in left.next_hops.iter().enumerate() {
            if let Some((peer, _)) = peers.get(link) {
                *self.stale.reach.entry(*peer).or_default() |= 1 << bit;
            }
        }
        let names = |links: &[u32]| -> Vec<Name> {
            let names: BTreeSet<Name> = links.iter().filter_map(|link| Some(peers.get(link)?.0)).collect();
            names.into_iter().collect()
        };
        let mut changes = Vec::new();
        for (name, plane) in &left.routes {
            let (locals, writers) = (names(&plane.readers), names(&plane.writers));
            let arrives_by = names(&plane.sources);
            let is_of = |link: &u32, local: &Name| peers.get(link).is_some_and(|(peer, _)| peer == local);
            let mut everywhere = Vec::new();
            for local in &locals {
                let mut links = plane.readers.iter().filter(|link| is_of(link, local));
                match (links.next(), links.next(), self.endpoints.get_mut(local)) {
                    (Some(_), Some(_), _) => everywhere.push(*local),
                    (Some(only), None, Some(ends)) => ends.prefer(*only),
                    _ => {}
                }
            }
            let route = Route { name: *name, egress_bits: plane.egress_bits, locals, everywhere, writers, arrives_by };
            let way = Way { route, anyone: plane.writers.contains(&ANY_WRITER) };
            let change = self.update(name, |routes| drop(routes.stale.routes.insert(*name, way)));
            changes.extend(change.filter(|change| *change != PlaneChange::Set(*name, plane.clone())));
        }
        changes
    }

    /// Applies a FIB push of the RIB.
    pub fn push(&mut self, push: &FibPush) -> Result<Vec<PlaneChange>, OutOfStep> {
        self.check_order(push)?;
        if self.run != Some(push.run) {
            self.make_known_stale();
            self.run = Some(push.run);
        }
        let mut changes = self.set_own_bit(push.own_bit % EGRESS_SET_SIZE as u8);
        self.generation = push.generation;
        if let Extent::Full { part: 0, .. } = push.extent {
            self.sweep = Some((self.known.routes.keys().copied().collect(), 0));
        }
        for route in &push.set {
            if let Some((unconfirmed, _)) = &mut self.sweep {
                unconfirmed.remove(&route.name);
            }
            let way = Way { route: route.clone(), anyone: false };
            changes.extend(self.update(&route.name, |routes| drop(routes.known.routes.insert(route.name, way))));
        }
        for name in &push.remove {
            changes.extend(self.update(name, |routes| {
                routes.known.routes.remove(name);
                routes.stale.routes.remove(name);
            }));
        }
        match push.extent {
            Extent::Full { last: true, .. } => {
                let (unconfirmed, _) = self.sweep.take().unwrap_or_default();
                for name in unconfirmed {
                    changes.extend(self.update(&name, |routes| drop(routes.known.routes.remove(&name))));
                }
                if !push.settling {
                    for name in self.stale.routes.keys().copied().collect::<Vec<_>>() {
                        changes.extend(self.update(&name, |routes| drop(routes.stale.routes.remove(&name))));
                    }
                }
            }
            Extent::Full { part, last: false } => {
                if let Some((_, next)) = &mut self.sweep {
                    *next = part.saturating_add(1);
                }
            }
            Extent::Delta => {}
        }
        Ok(changes)
    }

    /// Adds a link. It replaces the peer's earlier link on the lane once it [is
    /// ready](Self::link_ready).
    pub fn link_up(&mut self, role: LinkRole, peer: Name, lane: u8, link: u32) -> Vec<PlaneChange> {
        self.ends(role).entry(peer).or_default().up(lane, link);
        self.changes_of(role, &peer)
    }

    /// Marks a link as ready: the peer accepts frames on it.
    pub fn link_ready(&mut self, role: LinkRole, peer: Name, link: u32) -> Vec<PlaneChange> {
        let Some(ends) = self.ends(role).get_mut(&peer) else { return Vec::new() };
        let sent_on = |ends: &Ends| (ends.out(), ends.each().collect::<Vec<_>>());
        let before = sent_on(ends);
        ends.ready(link);
        if sent_on(ends) == before { Vec::new() } else { self.changes_of(role, &peer) }
    }

    /// Makes a link the one that an endpoint prefers for frames that go over only one of its links.
    /// Other frames to and from the endpoint are not affected.
    pub fn link_preferred(&mut self, peer: Name, link: u32) -> Vec<PlaneChange> {
        let Some(ends) = self.endpoints.get_mut(&peer) else { return Vec::new() };
        let before = ends.out();
        ends.prefer(link);
        if ends.out() == before {
            return Vec::new();
        }
        let ways = self.concerned.get(&peer).into_iter().flatten().filter_map(|name| self.way(name));
        let on_one = |way: &Way| way.route.locals.contains(&peer) && !way.route.everywhere.contains(&peer);
        ways.filter(on_one).map(|way| self.resolve(&way)).collect()
    }

    /// Returns the link that carries frames to an endpoint which go over only one of its links.
    pub fn link_to(&self, endpoint: &Name) -> Option<u32> {
        self.endpoints.get(endpoint)?.out()
    }

    /// Handles a silent link. Returns whether to keep it, because frames may still go over it.
    pub fn link_silent(&mut self, role: LinkRole, peer: &Name, link: u32) -> bool {
        self.ends(role).get_mut(peer).is_some_and(|ends| ends.silent(link))
    }

    /// Returns whether a newer link has replaced this one. Frames may still arrive on it.
    pub fn is_replaced(&mut self, role: LinkRole, peer: &Name, link: u32) -> bool {
        self.ends(role).get(peer).is_some_and(|ends| ends.is_earlier(link))
    }

    /// Removes a link. Returns the table changes, and the earlier links to the same peer that end
    /// with it.
    pub fn link_removed(&mut self, role: LinkRole, peer: Name, link: u32) -> (Vec<PlaneChange>, Vec<u32>) {
        let all = self.ends(role);
        let Some(ends) = all.get_mut(&peer) else { return Default::default() };
        let with_it = ends.removed(link);
        if ends.is_empty() {
            all.remove(&peer);
        }
        (self.changes_of(role, &peer), with_it)
    }

    /// Returns the index of this switch's own egress bit, once the RIB has assigned it.
    pub fn own_bit(&self) -> Option<u8> {
        self.own_bit
    }

    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Returns the number of names with a route.
    pub fn len(&self) -> usize {
        let only_held = self.stale.routes.keys().filter(|name| !self.known.routes.contains_key(name));
        self.known.routes.len() + only_held.count()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the number of names with receivers to which an endpoint may send.
    pub fn leading_from(&self, endpoint: &Name) -> usize {
        let ways = self.concerned.get(endpoint).into_iter().flatten().filter_map(|name| self.way(name));
        let leads = |route: &Route| route.egress_bits != 0 || !route.locals.is_empty();
        ways.filter(|way| way.route.writers.contains(endpoint) && leads(&way.route)).count()
    }

    /// Returns at most `most` names that an endpoint sends to or receives, without its own, and
    /// whether there are more.
    pub fn names_of(&self, endpoint: &Name, most: usize) -> (Vec<OwnName>, bool) {
        let names = self.concerned.get(endpoint).into_iter().flatten().filter(|name| *name != endpoint);
        let own = |way: Way| {
            let Route { name, egress_bits, locals, writers, .. } = way.route;
            OwnName {
                name,
                sends: writers.contains(endpoint),
                receives: locals.contains(endpoint),
                has_receivers: egress_bits != 0 || !locals.is_empty(),
            }
        };
        let mut names: Vec<OwnName> = names.filter_map(|name| self.way(name)).map(own).take(most + 1).collect();
        let truncated = names.len() > most;
        names.truncate(most);
        (names, truncated)
    }

    /// Returns the neighbours that reach these egress switches.
    pub fn neighbours_toward(&self, bits: u64) -> Vec<Name> {
        self.reach().into_iter().filter(|(_, reach)| *reach & bits != 0).map(|(name, _)| name).collect()
    }

    fn ends(&mut self, role: LinkRole) -> &mut HashMap<Name, Ends> {
        match role {
            LinkRole::Switch => &mut self.switches,
            LinkRole::Endpoint => &mut self.endpoints,
            LinkRole::Border => &mut self.borders,
        }
    }

    fn check_order(&self, push: &FibPush) -> Result<(), OutOfStep> {
        let next = self.run == Some(push.run) && push.generation == self.generation + 1;
        let in_order = match push.extent {
            Extent::Full { part: 0, .. } => true,
            Extent::Full { part, .. } => next && self.sweep.as_ref().is_some_and(|(_, expected)| *expected == part),
            Extent::Delta => next && self.sweep.is_none(),
        };
        if in_order { Ok(()) } else { Err(OutOfStep { current: self.generation, got: push.generation }) }
    }

    /// Moves the known routes to the stale layer, because a new RIB run starts empty.
    fn make_known_stale(&mut self) {
        for (name, way) in std::mem::take(&mut self.known.routes) {
            let joint = join(Some(&way), self.stale.routes.get(&name));
            self.stale.routes.extend(joint.map(|joint| (name, joint)));
        }
    }

    /// Returns the egress bits that each neighbour reaches. Stale paths count only where the
    /// topology has no path.
    fn reach(&self) -> BTreeMap<Name, u64> {
        let mut reach = self.known.reach.clone();
        let known = reach.values().fold(0, |all, bits| all | bits);
        for (neighbour, bits) in &self.stale.reach {
            *reach.entry(*neighbour).or_default() |= bits & !known;
        }
        reach.retain(|_, bits| *bits != 0);
        reach
    }

    fn set_own_bit(&mut self, bit: u8) -> Vec<PlaneChange> {
        let before = self.own_mask();
        self.own_bit = Some(bit);
        self.own_mask_after(before)
    }

    /// Returns the egress bit of this switch as a mask, or 0 if it has none.
    fn own_mask(&self) -> u64 {
        self.own_bit.filter(|_| !self.bit_is_lost).map_or(0, |bit| 1 << bit)
    }

    fn own_mask_after(&self, before: u64) -> Vec<PlaneChange> {
        let mask = self.own_mask();
        (mask != before).then_some(PlaneChange::OwnBit(mask)).into_iter().collect()
    }

    /// Sets the known paths of the topology.
    pub fn set_paths(&mut self, paths: &Paths, own: &Name) -> Vec<PlaneChange> {
        let (mask, before) = (self.own_mask(), self.reach());
        self.bit_is_lost = self.own_bit.and_then(|bit| paths.bits.get(&bit)).is_some_and(|has| has != own);
        self.known.reach = paths.reach.clone();
        let mut changes = self.own_mask_after(mask);
        changes.extend(self.reach_after(&before));
        changes
    }

    /// Drops the stale paths, so that only those of the topology count.
    pub fn end_stale_paths(&mut self) -> Vec<PlaneChange> {
        let before = self.reach();
        self.stale.reach.clear();
        self.reach_after(&before)
    }

    fn reach_after(&self, before: &BTreeMap<Name, u64>) -> Vec<PlaneChange> {
        let reach = self.reach();
        if reach == *before {
            return Vec::new();
        }
        let (used, unused) = self.reach_of(&reach, self.switches.iter());
        used.into_iter().chain([self.next_hops(&reach)]).chain(unused).collect()
    }

    /// Returns the changes that follow from new links to a peer.
    fn changes_of(&self, role: LinkRole, peer: &Name) -> Vec<PlaneChange> {
        match role {
            LinkRole::Switch => {
                let reach = self.reach();
                let (used, unused) = self.reach_of(&reach, self.switches.get_key_value(peer).into_iter());
                used.into_iter().chain([self.next_hops(&reach)]).chain(unused).collect()
            }
            LinkRole::Endpoint | LinkRole::Border => {
                let names = self.concerned.get(peer).into_iter().flatten();
                names.filter_map(|name| self.way(name)).map(|way| self.resolve(&way)).collect()
            }
        }
    }

    /// Returns the masks of the links to switches: of those to send on, and of all others, which
    /// are 0. In this order, a frame may be duplicated for a moment, but not lost.
    fn reach_of<'a>(
        &self,
        reach: &BTreeMap<Name, u64>,
        switches: impl Iterator<Item = (&'a Name, &'a Ends)>,
    ) -> (Vec<PlaneChange>, Vec<PlaneChange>) {
        let (mut used, mut unused) = (Vec::new(), Vec::new());
        for (switch, ends) in switches {
            for link in ends.all() {
                match ends.out() == Some(link) {
                    true => used.push(PlaneChange::Reach { link, bits: reach.get(switch).copied().unwrap_or(0) }),
                    false => unused.push(PlaneChange::Reach { link, bits: 0 }),
                }
            }
        }
        (used, unused)
    }

    fn next_hops(&self, reach: &BTreeMap<Name, u64>) -> PlaneChange {
        let mut next_hops = [0; EGRESS_SET_SIZE as usize];
        for (switch, bits) in reach {
            let Some(link) = self.switches.get(switch).and_then(Ends::out) else { continue };
            for (bit, next) in next_hops.iter_mut().enumerate() {
                if bits & 1 << bit != 0 {
                    *next = link;
                }
            }
        }
        PlaneChange::NextHops(Box::new(next_hops))
    }

    fn way(&self, name: &Name) -> Option<Way> {
        join(self.known.routes.get(name), self.stale.routes.get(name))
    }

    /// Changes the layers' routes of one name, and returns the resulting table change.
    fn update(&mut self, name: &Name, change: impl FnOnce(&mut Self)) -> Option<PlaneChange> {
        let before = self.way(name);
        change(self);
        let after = self.way(name);
        if before == after {
            return None;
        }
        for entity in before.iter().flat_map(concerned) {
            if let Some(names) = self.concerned.get_mut(entity) {
                names.remove(name);
                if names.is_empty() {
                    self.concerned.remove(entity);
                }
            }
        }
        for entity in after.iter().flat_map(concerned) {
            self.concerned.entry(*entity).or_default().insert(*name);
        }
        Some(after.map_or(PlaneChange::Remove(*name), |way| self.resolve(&way)))
    }

    /// Translates a route to links. Removes a name from the data plane if it leads nowhere from
    /// here and no border calls it.
    fn resolve(&self, Way { route, anyone }: &Way) -> PlaneChange {
        let borders = |names: &[Name]| names.iter().filter_map(|name| self.borders.get(name)).collect::<Vec<_>>();
        let ends = |names: &[Name]| -> Vec<&Ends> {
            names.iter().filter_map(|name| self.endpoints.get(name)).chain(borders(names)).collect()
        };
        let once = ends(&route.locals).into_iter().filter_map(Ends::out);
        let readers = sorted(once.chain(ends(&route.everywhere).into_iter().flat_map(Ends::each)));
        let writers = match anyone {
            true => vec![ANY_WRITER],
            false => sorted(ends(&route.writers).into_iter().flat_map(Ends::all)),
        };
        let sources = sorted(borders(&route.arrives_by).into_iter().flat_map(Ends::all));
        let plane = PlaneRoute { egress_bits: route.egress_bits, readers, writers, sources };
        if plane.is_idle() { PlaneChange::Remove(route.name) } else { PlaneChange::Set(route.name, plane) }
    }
}

impl Routes {
    /// Restricts names with unknown writers to the known writers.
    pub fn end_any_writer(&mut self) -> Vec<PlaneChange> {
        let open = self.stale.routes.iter().filter(|(_, way)| way.anyone).map(|(name, _)| *name);
        let close = |routes: &mut Self, name: &Name| {
            if let Some(way) = routes.stale.routes.get_mut(name) {
                way.anyone = false;
            }
        };
        open.collect::<Vec<_>>().iter().filter_map(|name| self.update(name, |routes| close(routes, name))).collect()
    }
}

/// Returns the union of both layers' routes for a name.
fn join(known: Option<&Way>, held: Option<&Way>) -> Option<Way> {
    let (Some(known), Some(held)) = (known, held) else { return known.or(held).cloned() };
    let both = |some: &[Name], more: &[Name]| sorted(some.iter().chain(more).copied());
    let route = Route {
        name: known.route.name,
        egress_bits: known.route.egress_bits | held.route.egress_bits,
        locals: both(&known.route.locals, &held.route.locals),
        everywhere: both(&known.route.everywhere, &held.route.everywhere),
        writers: both(&known.route.writers, &held.route.writers),
        arrives_by: both(&known.route.arrives_by, &held.route.arrives_by),
    };
    Some(Way { route, anyone: known.anyone || held.anyone })
}

fn sorted<T: Ord>(items: impl Iterator<Item = T>) -> Vec<T> {
    BTreeSet::from_iter(items).into_iter().collect()
}

/// Returns the local endpoints that read or write a name, and the border switches of other domains
/// that it concerns.
fn concerned(way: &Way) -> impl Iterator<Item = &Name> {
    way.route.locals.iter().chain(&way.route.writers).chain(&way.route.arrives_by)
}

#[cfg(test)]
#[path = "../../tests/unit/serve/routes.rs"]
mod tests;
