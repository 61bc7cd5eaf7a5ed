//! What the data planes hold from before this daemon: links, routes and next hops that an earlier one left in the kernel.
//! Peers go on using them until they have made their links anew, so each stays until it is replaced or [`Hold::until`] is
//! over. Says what the tables should hold in the meantime; [`super::core`] writes them.

use std::collections::{BTreeMap, HashMap};
use std::time::Instant;

use gdp::link::{HOLD, LinkId, LinkIds};
use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;

use crate::plane::{Left, PlaneRoute};

/// Link by egress bit.
pub type NextHops = [u32; EGRESS_SET_SIZE as usize];

/// What is held. Empty, unless there was a daemon before.
pub struct Hold {
    /// Kept so that no new link gets the same index.
    links: HashMap<u32, LinkId>,
    /// Routes that nobody has confirmed or taken back.
    routes: BTreeMap<Name, PlaneRoute>,
    next_hops: NextHops,
    until: Option<Instant>,
}

impl Default for Hold {
    fn default() -> Self {
        Self { links: HashMap::new(), routes: BTreeMap::new(), next_hops: [0; EGRESS_SET_SIZE as usize], until: None }
    }
}

impl Hold {
    /// Holds what was left, from now on. `ids`: those that new links get.
    pub fn new(left: &Left, ids: &LinkIds, now: Instant) -> Self {
        Self {
            links: left.links.iter().filter_map(|entry| Some((entry.id, ids.reserve(entry.id)?))).collect(),
            routes: left.routes.iter().cloned().collect(),
            next_hops: left.next_hops,
            until: Some(now + HOLD),
        }
    }

    /// How many links and routes.
    pub fn len(&self) -> (usize, usize) {
        (self.links.len(), self.routes.len())
    }

    /// The next hops to forward by: those that are known, and where there is none the one from before.
    pub fn next_hops(&self, known: &NextHops) -> NextHops {
        std::array::from_fn(|bit| match known[bit] {
            0 if self.links.contains_key(&self.next_hops[bit]) => self.next_hops[bit],
            link => link,
        })
    }

    /// The route to set where `route` is known of the name. `awaits`: its endpoint here has no link yet; it then still
    /// gets its frames on the one from before.
    pub fn set(&mut self, name: &Name, mut route: PlaneRoute, awaits: bool) -> PlaneRoute {
        match self.routes.get(name) {
            Some(held) if awaits => {
                route.readers.clone_from(&held.readers);
                if route.writers.is_empty() {
                    route.writers.clone_from(&held.writers);
                }
            }
            _ => {
                self.routes.remove(name);
            }
        }
        route
    }

    /// Whether the name's route goes, when nothing is known that leads there.
    pub fn remove(&mut self, name: &Name, awaits: bool) -> bool {
        if awaits && self.routes.contains_key(name) {
            return false;
        }
        self.routes.remove(name);
        true
    }

    /// Once the time is over, all links and routes that are still held: to be removed.
    pub fn expire(&mut self, now: Instant) -> Option<(Vec<u32>, Vec<Name>)> {
        self.until.take_if(|until| *until <= now)?;
        let held = std::mem::take(self);
        Some((held.links.into_keys().collect(), held.routes.into_keys().collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::{PlaneConfig, Planes, Wanted};
    use gdp_wire::table::MAX_LINKS;

    #[test]
    fn a_route_stays_on_the_old_link_until_its_endpoint_has_a_new_one() {
        let (mut hold, _) = held();
        let known = PlaneRoute { egress_bits: 3, ..PlaneRoute::default() };
        assert!(!hold.remove(&name(1), true), "the endpoint is not back yet");
        let old = PlaneRoute { readers: vec![OLD], ..known.clone() };
        assert_eq!(hold.set(&name(1), known.clone(), true), old);
        let found = PlaneRoute { readers: vec![0x2405], ..known };
        assert_eq!(hold.set(&name(1), found.clone(), false), found);
        assert!(hold.remove(&name(1), true), "it is no longer the old one");
        assert!(hold.remove(&name(2), false), "taken back by the RIB");
        assert_eq!(hold.len(), (1, 0));
    }

    #[test]
    fn next_hops_are_the_old_ones_where_there_is_no_new_one() {
        let (hold, _) = held();
        let mut known = [0; EGRESS_SET_SIZE as usize];
        assert_eq!(hold.next_hops(&known)[..3], [0, OLD, 0], "bit 2 led to a link that was not found again");
        known[1] = 0x2406;
        known[2] = 0x2407;
        assert_eq!(hold.next_hops(&known)[..3], [0, 0x2406, 0x2407]);
    }

    #[test]
    fn what_nobody_confirmed_is_removed_in_the_end() {
        let (mut hold, ids) = held();
        hold.set(&name(1), PlaneRoute::default(), false);
        let start = hold.until.expect("there is something") - HOLD;
        assert_eq!(hold.expire(start + HOLD / 2), None);
        assert!(ids.reserve(OLD + MAX_LINKS).is_none(), "no new link takes its place in the tables");
        assert_eq!(hold.expire(start + HOLD), Some((vec![OLD], vec![name(2)])));
        assert_eq!((hold.expire(start + HOLD * 2), hold.len()), (None, (0, 0)));
        assert!(ids.reserve(OLD + MAX_LINKS).is_some());
    }

    #[test]
    fn without_a_daemon_before_nothing_is_held() {
        let planes = Planes::open(PlaneConfig { wanted: Wanted::Userspace, ..PlaneConfig::default() }).unwrap();
        assert_eq!(planes.left(), None);
        let mut hold = Hold::default();
        assert!(hold.remove(&name(1), true));
        assert_eq!(hold.expire(Instant::now() + HOLD * 2), None);
    }

    const OLD: u32 = 0x1405;

    fn held() -> (Hold, LinkIds) {
        let ids = LinkIds::new();
        let route = |i| (name(i), PlaneRoute { egress_bits: 1, readers: vec![OLD], writers: vec![] });
        let mut next_hops = [0; EGRESS_SET_SIZE as usize];
        next_hops[1..3].copy_from_slice(&[OLD, 0x1499]);
        let links = vec![gdp_wire::LinkEntry { id: OLD, ..Default::default() }];
        let left = Left { links, routes: vec![route(1), route(2)], next_hops, ports: Default::default() };
        (Hold::new(&left, &ids, Instant::now()), ids)
    }

    fn name(i: u8) -> Name {
        Name::from_bytes([i; 32])
    }
}
