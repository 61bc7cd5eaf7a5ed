//! What this switch's FIB says, in names, and what that means in links: pushes from the RIB and links coming and going go
//! in, changes of the data plane's tables come out. Sans-IO.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use gdp::control::{Extent, FibPush, Route};
use gdp::link::Role;
use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;

use crate::plane::PlaneRoute;

/// One change of the data plane's tables. To be carried out in order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// This switch's own egress bit, as a mask.
    OwnBit(u64),
    /// Which egress switches the neighbour on this link leads to.
    Reach {
        link: u32,
        bits: u64,
    },
    NextHops(Box<[u32; EGRESS_SET_SIZE as usize]>),
    Set(Name, PlaneRoute),
    Remove(Name),
}

/// A push that does not follow what the switch holds: it needs the whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the switch holds generation {held}, so it cannot apply a change to generation {got}; send the whole FIB")]
pub struct OutOfStep {
    pub held: u64,
    pub got: u64,
}

/// The FIB in names, and the links those names are at.
#[derive(Debug, Default)]
pub struct Routes {
    own_bit: Option<u8>,
    reach: BTreeMap<Name, u64>,
    routes: HashMap<Name, Route>,
    generation: u64,
    /// What a transfer of the whole has not confirmed yet, and its next part.
    sweep: Option<(HashSet<Name>, u32)>,
    switches: HashMap<Name, u32>,
    endpoints: HashMap<Name, u32>,
    /// Names that each local endpoint reads or writes.
    concerned: HashMap<Name, BTreeSet<Name>>,
}

impl Routes {
    /// Applies a push from the RIB.
    pub fn push(&mut self, push: &FibPush) -> Result<Vec<Change>, OutOfStep> {
        self.check_order(push)?;
        let mut changes = self.set_paths(push);
        self.generation = push.generation;
        if let Extent::Full { part: 0, .. } = push.extent {
            self.sweep = Some((self.routes.keys().copied().collect(), 0));
        }
        for route in &push.set {
            if let Some((unconfirmed, _)) = &mut self.sweep {
                unconfirmed.remove(&route.name);
            }
            changes.extend(self.set(route));
        }
        for name in &push.remove {
            changes.extend(self.remove(name));
        }
        match push.extent {
            Extent::Full { last: true, .. } => {
                let (unconfirmed, _) = self.sweep.take().unwrap_or_default();
                for name in unconfirmed {
                    changes.extend(self.remove(&name));
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

    /// A link is up; it replaces one to the same peer.
    pub fn link_up(&mut self, role: Role, peer: Name, link: u32) -> Vec<Change> {
        match role {
            Role::Switch => {
                self.switches.insert(peer, link);
                let bits = self.reach.get(&peer).copied().unwrap_or(0);
                vec![Change::Reach { link, bits }, self.next_hops()]
            }
            Role::Endpoint => {
                self.endpoints.insert(peer, link);
                self.resolve_all_of(&peer)
            }
        }
    }

    /// A link is gone. Nothing happens if another one to the same peer has replaced it.
    pub fn link_down(&mut self, role: Role, peer: Name, link: u32) -> Vec<Change> {
        match role {
            Role::Switch if self.switches.get(&peer) == Some(&link) => {
                self.switches.remove(&peer);
                vec![self.next_hops()]
            }
            Role::Endpoint if self.endpoints.get(&peer) == Some(&link) => {
                self.endpoints.remove(&peer);
                self.resolve_all_of(&peer)
            }
            _ => Vec::new(),
        }
    }

    /// Whether the name is to be delivered to an endpoint here that has no link.
    pub fn awaits(&self, name: &Name) -> bool {
        let local = self.routes.get(name).and_then(|route| route.local);
        local.is_some_and(|endpoint| !self.endpoints.contains_key(&endpoint))
    }

    /// Index of this switch's own egress bit, once the RIB has told it.
    pub fn own_bit(&self) -> Option<u8> {
        self.own_bit
    }

    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Names that the RIB wants routed here.
    pub fn len(&self) -> usize {
        self.routes.len()
    }

    pub fn is_empty(&self) -> bool {
        self.routes.is_empty()
    }

    /// The neighbours that lead to these egress switches.
    pub fn neighbours_toward(&self, bits: u64) -> Vec<Name> {
        self.reach.iter().filter(|(_, reach)| *reach & bits != 0).map(|(name, _)| *name).collect()
    }

    fn check_order(&self, push: &FibPush) -> Result<(), OutOfStep> {
        let in_order = match push.extent {
            Extent::Full { part: 0, .. } => true,
            Extent::Full { part, .. } => {
                self.sweep.as_ref().is_some_and(|(_, next)| *next == part) && push.generation == self.generation + 1
            }
            Extent::Delta => self.sweep.is_none() && push.generation == self.generation + 1 && self.generation != 0,
        };
        if in_order { Ok(()) } else { Err(OutOfStep { held: self.generation, got: push.generation }) }
    }

    fn set_paths(&mut self, push: &FibPush) -> Vec<Change> {
        let mut changes = Vec::new();
        let own_bit = push.own_bit % EGRESS_SET_SIZE as u8;
        if self.own_bit != Some(own_bit) {
            self.own_bit = Some(own_bit);
            changes.push(Change::OwnBit(1 << own_bit));
        }
        let reach: BTreeMap<Name, u64> = push.reach.iter().copied().collect();
        if reach != self.reach {
            self.reach = reach;
            for (switch, link) in &self.switches {
                changes.push(Change::Reach { link: *link, bits: self.reach.get(switch).copied().unwrap_or(0) });
            }
            changes.push(self.next_hops());
        }
        changes
    }

    fn next_hops(&self) -> Change {
        let mut next_hops = [0; EGRESS_SET_SIZE as usize];
        for (switch, bits) in &self.reach {
            let Some(link) = self.switches.get(switch) else { continue };
            for (bit, next) in next_hops.iter_mut().enumerate() {
                if bits & 1 << bit != 0 {
                    *next = *link;
                }
            }
        }
        Change::NextHops(Box::new(next_hops))
    }

    fn set(&mut self, route: &Route) -> Option<Change> {
        let before = self.routes.insert(route.name, route.clone());
        if before.as_ref() == Some(route) {
            return None;
        }
        before.iter().for_each(|before| self.forget_concerned(before));
        for entity in concerned(route) {
            self.concerned.entry(*entity).or_default().insert(route.name);
        }
        Some(self.resolve(route))
    }

    fn remove(&mut self, name: &Name) -> Option<Change> {
        let before = self.routes.remove(name)?;
        self.forget_concerned(&before);
        Some(Change::Remove(*name))
    }

    fn forget_concerned(&mut self, route: &Route) {
        for entity in concerned(route) {
            if let Some(names) = self.concerned.get_mut(entity) {
                names.remove(&route.name);
                if names.is_empty() {
                    self.concerned.remove(entity);
                }
            }
        }
    }

    fn resolve_all_of(&self, endpoint: &Name) -> Vec<Change> {
        let names = self.concerned.get(endpoint).into_iter().flatten();
        names.filter_map(|name| self.routes.get(name)).map(|route| self.resolve(route)).collect()
    }

    /// A name without bits and without a link here leads nowhere: then the data plane need not hold it.
    fn resolve(&self, route: &Route) -> Change {
        let readers: Vec<u32> = route.local.iter().filter_map(|local| self.endpoints.get(local)).copied().collect();
        if route.egress_bits == 0 && readers.is_empty() {
            return Change::Remove(route.name);
        }
        let writers = sorted(route.writers.iter().filter_map(|writer| self.endpoints.get(writer)));
        Change::Set(route.name, PlaneRoute { egress_bits: route.egress_bits, readers, writers })
    }
}

fn sorted<'a>(links: impl Iterator<Item = &'a u32>) -> Vec<u32> {
    let set: BTreeSet<u32> = links.copied().collect();
    set.into_iter().collect()
}

/// The local endpoints that read or write a name.
fn concerned(route: &Route) -> impl Iterator<Item = &Name> {
    route.local.iter().chain(&route.writers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_links_and_follow_them() {
        let mut r = Routes::default();
        let first = push(1, Extent::Full { part: 0, last: true }, vec![route(1, 0, Some(7)), route(2, 4, None)]);
        let changes = r.push(&first).unwrap();
        assert_eq!(changes[0], Change::OwnBit(2));
        assert!(changes.contains(&Change::Remove(name(1))), "its endpoint has no link yet");
        assert!(changes.contains(&set(2, 4, &[], &[])));

        assert_eq!(r.link_up(Role::Endpoint, name(7), 70), [set(1, 0, &[70], &[])]);
        assert_eq!(r.link_up(Role::Endpoint, name(7), 71), [set(1, 0, &[71], &[])], "it moved");
        assert_eq!(r.link_down(Role::Endpoint, name(7), 70), [], "the old link no longer matters");
        assert_eq!(r.link_down(Role::Endpoint, name(7), 71), [Change::Remove(name(1))]);

        let changes = r.link_up(Role::Switch, name(9), 90);
        assert_eq!(changes[0], Change::Reach { link: 90, bits: 0b101 });
        assert_eq!(hops(&changes[1])[..4], [90, 0, 90, 0]);
        let changes = r.link_down(Role::Switch, name(9), 90);
        assert_eq!(hops(&changes[0])[..4], [0; 4]);
    }

    #[test]
    fn writers_become_links_and_lose_their_permission_with_them() {
        let mut r = Routes::default();
        let written = |by: &[u8]| Route { writers: by.iter().copied().map(name).collect(), ..route(1, 4, None) };
        let by = |writers: &[u32]| set(1, 4, &[], writers);
        let first = r.push(&push(1, Extent::Full { part: 0, last: true }, vec![written(&[7, 8, 9])])).unwrap();
        assert!(first.contains(&by(&[])), "none of them has a link");
        assert_eq!(r.link_up(Role::Endpoint, name(8), 80), [by(&[80])]);
        assert_eq!(r.link_up(Role::Endpoint, name(7), 70), [by(&[70, 80])]);
        assert_eq!(r.link_up(Role::Endpoint, name(9), 90), [by(&[70, 80, 90])]);
        assert_eq!(r.link_up(Role::Endpoint, name(6), 60), [], "this one does not publish it");
        assert_eq!(r.push(&push(2, Extent::Delta, vec![written(&[8, 9])])).unwrap(), [by(&[80, 90])]);
        assert_eq!(r.link_down(Role::Endpoint, name(7), 70), [], "nor does this one any more");
        assert_eq!(r.link_down(Role::Endpoint, name(8), 80), [by(&[90])]);
        assert_eq!(r.link_down(Role::Endpoint, name(9), 90), [by(&[])]);
    }

    #[test]
    fn the_whole_sweeps_what_it_does_not_name() {
        let mut r = Routes::default();
        r.push(&push(1, Extent::Full { part: 0, last: true }, vec![route(1, 1, None), route(2, 1, None)])).unwrap();
        let changes = r.push(&push(9, Extent::Full { part: 0, last: false }, vec![route(3, 1, None)])).unwrap();
        assert_eq!(changes, [set(3, 1, &[], &[])], "nothing is swept before the last part");
        let changes = r.push(&push(10, Extent::Full { part: 1, last: true }, vec![route(2, 1, None)])).unwrap();
        assert_eq!(changes, [Change::Remove(name(1))], "and what was confirmed is not touched");
        assert_eq!(r.len(), 2);
    }

    #[test]
    fn a_push_out_of_step_changes_nothing() {
        let mut r = Routes::default();
        let set = vec![route(1, 1, None)];
        assert!(r.push(&push(1, Extent::Delta, set.clone())).is_err(), "a change of nothing");
        assert!(r.push(&push(1, Extent::Full { part: 1, last: true }, set.clone())).is_err(), "a part without a first");
        r.push(&push(5, Extent::Full { part: 0, last: true }, set.clone())).unwrap();
        for generation in [4, 5, 7] {
            assert_eq!(r.push(&push(generation, Extent::Delta, vec![])), Err(OutOfStep { held: 5, got: generation }));
        }
        let mut delta = push(6, Extent::Delta, vec![]);
        delta.remove = vec![name(1), name(2)];
        assert_eq!(r.push(&delta).unwrap(), [Change::Remove(name(1))]);
        r.push(&push(7, Extent::Full { part: 0, last: false }, vec![])).unwrap();
        assert!(r.push(&push(8, Extent::Delta, vec![])).is_err(), "a change in the middle of a transfer");
        assert!(r.push(&push(8, Extent::Full { part: 2, last: true }, vec![])).is_err(), "a part is missing");
    }

    fn push(generation: u64, extent: Extent, set: Vec<Route>) -> FibPush {
        FibPush { switch: name(0), generation, extent, own_bit: 1, reach: vec![(name(9), 0b101)], set, remove: vec![] }
    }

    fn route(i: u8, egress_bits: u64, local: Option<u8>) -> Route {
        Route { name: name(i), egress_bits, local: local.map(name), writers: vec![] }
    }

    fn set(i: u8, egress_bits: u64, readers: &[u32], writers: &[u32]) -> Change {
        Change::Set(name(i), PlaneRoute { egress_bits, readers: readers.into(), writers: writers.into() })
    }

    fn hops(change: &Change) -> &[u32; 64] {
        let Change::NextHops(hops) = change else { panic!("{change:?}") };
        hops
    }

    fn name(i: u8) -> Name {
        Name::from_bytes([i; 32])
    }
}
