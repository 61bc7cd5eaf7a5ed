//! Nodes joined by links, in simulated time.
//!
//! A node is what the test makes of it, known here by a number of the test's own. The test's loop:
//! [`Network::arrival`] until the earliest of its nodes' own times; give the node what came or wake
//! it; [`Network::send`] what it answers. One that only forwards makes several flows share the link
//! behind it.

use crate::{Counts, Delivery, Faults, Link, Random};

/// Links between nodes, and the time.
#[derive(Clone, Debug)]
pub struct Network<T> {
    now: u64,
    seeds: Random,
    directions: Vec<Direction<T>>,
}

/// Two links, one each way. Two nodes may be joined by several.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Cable(usize);

/// A frame that has reached a node.
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

    /// `there`: from the first node to the second; `back`: from the second to the first.
    ///
    /// # Panics
    ///
    /// As [`Link::new`]; and if a node is joined to itself.
    pub fn join(&mut self, [a, b]: [usize; 2], there: Faults, back: Faults) -> Cable {
        assert!(a != b, "node {a} is joined to itself");
        let cable = Cable(self.directions.len() / 2);
        for (from, to, faults) in [(a, b, there), (b, a, back)] {
            self.directions.push(Direction { from, to, link: Link::new(faults, self.seeds.number()) });
        }
        cable
    }

    /// From a node at one end of a cable to the node at the other, now.
    ///
    /// # Panics
    ///
    /// If the cable does not begin at `from`.
    pub fn send(&mut self, from: usize, cable: Cable, frame: T, bytes: usize) {
        let direction = self.index(from, cable);
        self.directions[direction].link.push(self.now, frame, bytes);
    }

    /// Lets time go on to the next arrival, or to `until` if there is none before.
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

    /// Of the direction of a cable that begins at `from`.
    ///
    /// # Panics
    ///
    /// If none does.
    pub fn counts(&self, from: usize, cable: Cable) -> Counts {
        self.directions[self.index(from, cable)].link.counts()
    }

    fn index(&self, from: usize, cable: Cable) -> usize {
        let both = [2 * cable.0, 2 * cable.0 + 1];
        let index = both.into_iter().find(|index| self.directions[*index].from == from);
        index.unwrap_or_else(|| panic!("{cable:?} does not begin at node {from}"))
    }
}
