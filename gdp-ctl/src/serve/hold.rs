//! What the data planes hold from before this daemon: links, routes and next hops that an earlier one left in the kernel.
//! Peers go on using them until they have made their links anew, so each stays until it is replaced or [`Hold::until`] is
//! over. Says what the tables should hold in the meantime; [`super::core`] writes them.

use std::collections::{BTreeMap, HashMap};
use std::time::Instant;

use gdp::link::{HOLD, LinkId, LinkIds};
use gdp_wire::table::EGRESS_SET_SIZE;
use gdp_wire::{FibEntry, Name};

use crate::plane::Left;

/// Link by egress bit.
pub type NextHops = [u32; EGRESS_SET_SIZE as usize];

/// What is held. Empty, unless there was a daemon before.
pub struct Hold {
    /// Kept so that no new link gets the same index.
    links: HashMap<u32, LinkId>,
    /// Routes that nobody has confirmed or taken back.
    routes: BTreeMap<Name, FibEntry>,
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
            routes: left.routes.iter().copied().collect(),
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

    /// The route to set where `entry` is known of the name. `awaits`: its endpoint here has no link yet; it then still
    /// gets its frames on the one from before.
    pub fn set(&mut self, name: &Name, entry: FibEntry, awaits: bool) -> FibEntry {
        match self.routes.get(name) {
            Some(held) if awaits => FibEntry { local_link: held.local_link, ..entry },
            _ => {
                self.routes.remove(name);
                entry
            }
        }
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
