//! Nodes joined by links, in simulated time.
//!
//! A test implements the nodes and numbers them. It loops over three steps. [`Network::arrival`]
//! advances to the next frame, or to the earliest timer of the nodes. The test then passes the
//! frame to its node, or wakes the node. [`Network::send`] sends the node's responses. A node that
//! only forwards lets several flows share the link behind it.

use crate::{Counts, Delivery, Faults, Link, Random};

/// Links between nodes, and the simulated time.
#[derive(Clone, Debug)]
pub struct Network<T> {
    now: u64,
    seeds: Random,
    directions: Vec<Direction<T>>,
}

/// A pair of links, one in each direction. Several cables may join two nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Cable(usize);

/// A frame that has arrived at a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arrival<T> {
    pub to: usize,
    pub from: usize,
    pub cable: Cable,
    pub delivery: Delivery<T>,
}

#[derive(Clone, Debug)]
struct Direction<T> {
    from: usize,
    to: usize,
    link: Link<T>,
}

impl<T: Clone> Network<T> {
    pub fn new(seed: u64) -> Self {
        Self { now: 0, seeds: Random::new(seed), directions: Vec::new() }
    }

    /// Joins two nodes. `there` applies from the first node to the second, and `back` in the other
    /// direction.
    ///
    /// # Panics
    ///
    /// As [`Link::new`], and if both nodes are the same.
    pub fn join(&mut self, [a, b]: [usize; 2], there: Faults, back: Faults) -> Cable {
        assert!(a != b, "node {a} is joined to itself");
        let cable = Cable(self.directions.len() / 2);
        for (from, to, faults) in [(a, b, there), (b, a, back)] {
            self.directions.push(Direction { from, to, link: Link::new(faults, self.seeds.number()) });
        }
        cable
    }

    /// Sends a frame of `bytes` bytes from the node `from` to the other end of a cable.
    ///
    /// # Panics
    ///
    /// If the cable does not begin at `from`.
    pub fn send(&mut self, from: usize, cable: Cable, frame: T, bytes: usize) {
        let direction = self.index(from, cable);
        self.directions[direction].link.push(self.now, frame, bytes);
    }

    /// Advances the time to the next arrival and returns it. Advances to `until` if none comes
    /// before.
    pub fn arrival(&mut self, until: u64) -> Option<Arrival<T>> {
        let next = |(index, direction): (usize, &Direction<T>)| direction.link.next().map(|at| (at, index));
        let first = self.directions.iter().enumerate().filter_map(next).min();
        let Some((at, index)) = first.filter(|(at, _)| *at <= until) else {
            self.now = self.now.max(until);
            return None;
        };
        self.now = self.now.max(at);
        let Direction { from, to, link } = &mut self.directions[index];
        link.pop(at).map(|delivery| Arrival { to: *to, from: *from, cable: Cable(index / 2), delivery })
    }

    pub fn now(&self) -> u64 {
        self.now
    }

    /// Returns the counters of the direction that begins at `from`.
    ///
    /// # Panics
    ///
    /// If the cable does not begin at `from`.
    pub fn counts(&self, from: usize, cable: Cable) -> Counts {
        self.directions[self.index(from, cable)].link.counts()
    }

    fn index(&self, from: usize, cable: Cable) -> usize {
        let both = [2 * cable.0, 2 * cable.0 + 1];
        let index = both.into_iter().find(|index| self.directions[*index].from == from);
        index.unwrap_or_else(|| panic!("{cable:?} does not begin at node {from}"))
    }
}
