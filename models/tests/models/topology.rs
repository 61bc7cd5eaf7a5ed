//! Topology of three switches in a ring: floods are lost, repeated and overtake each other, links
//! go and come, and switches restart with a clock that went back.
//!
//! The switches are those of `gdp_rib::topology`, with their signatures. Requests take any time
//! below the renewal of statements.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::identity::{Identity, SigningKey};
use gdp_proto::control::Flooded;
use gdp_rib::topology::{Batch, BatchId, Topology, Verified};
use stateright::{Checker, HasDiscoveries, Model, Property};

use crate::{DebugHash, faults};

const SWITCHES: usize = 3;

/// Longest time that a run waits at once. Timers beyond it are those of renewal and expiry.
const LONGEST_WAIT: Duration = Duration::from_secs(10);

/// Run of a switch whose clock went back.
const OLD_RUN: u64 = 7;

const RUN: u64 = 1000;

#[test]
fn switches_converge_after_a_switch_is_cut_off() {
    check(&[Step::Cut(0, 1), Step::Cut(1, 2)], 2);
}

#[test]
fn switches_converge_after_a_link_comes() {
    check(&[Step::Cut(0, 1), Step::Join(0, 1)], 0);
}

#[test]
fn switches_converge_after_one_restarts_with_an_old_clock() {
    check(&[Step::Cut(0, 1), Step::Cut(0, 2), Step::Restart(0), Step::Join(0, 1)], 0);
}

/// Checks everything that may follow these events, which happen in a ring at once.
fn check(begin: &[Step], losses: u32) {
    let checker = Ring::new(begin, losses + faults(0), faults(0))
        .checker()
        .finish_when(HasDiscoveries::AnyFailures)
        .spawn_dfs()
        .join();
    println!("{begin:?}: {} states, at most {} steps", checker.unique_state_count(), checker.max_depth());
    checker.assert_properties();
}

/// The state after the first events.
struct Ring(World);

#[derive(Clone, Debug)]
struct World {
    now: Duration,
    switches: Vec<Topology>,
    /// Links by their ends, the lower first.
    cables: BTreeMap<(usize, usize), u32>,
    made: u32,
    /// What is under way, in an order that does not depend on its history.
    sent: BTreeMap<Key, Vec<Flooded>>,
    /// Batches that may still be lost, repeated or late.
    losses: u32,
    /// Changes of links and restarts that may still happen.
    changes: u32,
}

/// A flood of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Key {
    from: usize,
    to: usize,
    batch: BatchId,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Step {
    /// A batch arrives, and the sender learns so.
    Deliver(Key),
    /// A batch does not arrive. The sender repeats it.
    Lose(Key),
    /// A batch arrives, and the sender repeats it nevertheless.
    LoseAnswer(Key),
    Cut(usize, usize),
    Join(usize, usize),
    Restart(usize),
    /// Nothing is under way until the next timer.
    Wait,
    /// What is under way takes longer than the next timer.
    Delay,
}

impl Model for Ring {
    type State = DebugHash<World>;
    type Action = Step;

    fn init_states(&self) -> Vec<Self::State> {
        vec![DebugHash::new(self.0.clone())]
    }

    fn actions(&self, state: &Self::State, steps: &mut Vec<Step>) {
        let world = state.get();
        steps.extend(world.sent.keys().copied().map(Step::Deliver));
        if world.sent.is_empty() {
            steps.extend(world.wait().map(|_| Step::Wait));
        }
        let is_gone = |key: &&Key| !world.cables.values().any(|link| *link == key.batch.link);
        if world.losses == 0 {
            steps.extend(world.sent.keys().filter(is_gone).copied().map(Step::Lose));
        } else {
            steps.extend(world.sent.keys().copied().flat_map(|key| [Step::Lose(key), Step::LoseAnswer(key)]));
            steps.extend(world.wait().filter(|_| !world.sent.is_empty()).map(|_| Step::Delay));
        }
        if world.changes == 0 {
            return;
        }
        steps.extend((0..SWITCHES).map(Step::Restart));
        for (a, b) in pairs() {
            steps.push(if world.cables.contains_key(&(a, b)) { Step::Cut(a, b) } else { Step::Join(a, b) });
        }
    }

    fn next_state(&self, last: &Self::State, step: Step) -> Option<Self::State> {
        let mut world = last.get().clone();
        world.step(&step);
        Some(DebugHash::new(world))
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always("whenever it is quiet, all paths are those of the links", |_, state: &Self::State| {
                !state.get().is_quiet() || state.get().has_converged()
            }),
            Property::always("no bit is behind two neighbours or the switch's own", |_, state: &Self::State| {
                state.get().switches.iter().enumerate().all(|(i, switch)| {
                    let mut seen = 1 << i;
                    switch.paths().reach.values().all(|bits| {
                        seen & bits == 0 && {
                            seen |= bits;
                            true
                        }
                    })
                })
            }),
            Property::eventually("it becomes quiet after the last fault", |_, state: &Self::State| {
                state.get().changes == 0 && state.get().is_quiet() && state.get().has_converged()
            }),
        ]
    }
}

impl Ring {
    /// Connects the switches, lets them converge, and begins.
    fn new(begin: &[Step], losses: u32, changes: u32) -> Self {
        let switches = (0..SWITCHES).map(|i| switch(i, RUN));
        let (now, cables, sent) = (Duration::from_secs(100), BTreeMap::new(), BTreeMap::new());
        let mut world = World { now, switches: switches.collect(), cables, made: 0, sent, losses: 0, changes: 0 };
        world.join(&pairs().collect::<Vec<_>>());
        loop {
            let next = world.sent.keys().next().copied().map(Step::Deliver);
            let Some(step) = next.or_else(|| world.wait().map(|_| Step::Wait)) else { break };
            world.step(&step);
        }
        // The first statements after a quiet time are not delayed.
        world.now += LONGEST_WAIT;
        assert!(world.has_converged(), "without faults: {world:?}");
        begin.iter().for_each(|step| world.step(step));
        (world.losses, world.changes) = (losses, changes);
        Self(world)
    }
}

impl World {
    fn step(&mut self, step: &Step) {
        match step {
            Step::Deliver(_) | Step::Wait => {}
            Step::Lose(_) | Step::LoseAnswer(_) | Step::Delay => self.losses = self.losses.saturating_sub(1),
            Step::Cut(..) | Step::Join(..) | Step::Restart(_) => self.changes = self.changes.saturating_sub(1),
        }
        match *step {
            Step::Deliver(key) => self.deliver(key, true),
            Step::LoseAnswer(key) => self.deliver(key, false),
            Step::Lose(key) => {
                self.sent.remove(&key);
                self.answer(key, false);
            }
            Step::Cut(a, b) => self.cut(&[(a, b)]),
            Step::Join(a, b) => self.join(&[(a, b)]),
            Step::Restart(i) => {
                let near: Vec<_> = self.cables.keys().filter(|(a, b)| *a == i || *b == i).copied().collect();
                self.cut(&near);
                self.sent.retain(|key, _| key.to != i);
                self.switches[i] = switch(i, OLD_RUN);
                self.join(&near);
            }
            Step::Wait | Step::Delay => {
                self.now = self.wait().unwrap_or(self.now);
                (0..SWITCHES).for_each(|i| self.act(i));
            }
        }
    }

    fn deliver(&mut self, key: Key, is_answered: bool) {
        let Some(states) = self.sent.remove(&key) else { return };
        let switch = &mut self.switches[key.to];
        let news = switch.news(key.batch.link, states).expect("no switch sends what does not decode");
        let news = news.into_iter().map(|flooded| Verified::new(flooded).expect("each signs its own"));
        switch.learn(self.now, key.batch.link, news.collect());
        self.act(key.to);
        self.answer(key, is_answered);
    }

    fn answer(&mut self, key: Key, arrived: bool) {
        self.switches[key.from].answered(self.now, key.batch, arrived);
        self.act(key.from);
    }

    /// All ends notice at once.
    fn cut(&mut self, links: &[(usize, usize)]) {
        for (a, b) in links {
            let Some(link) = self.cables.remove(&(*a, *b)) else { continue };
            [a, b].iter().for_each(|end| self.switches[**end].link_down(link));
        }
        self.set_neighbours(links);
    }

    fn join(&mut self, links: &[(usize, usize)]) {
        for (a, b) in links {
            self.made += 1;
            self.cables.insert((*a, *b), self.made);
            [a, b].iter().for_each(|end| self.switches[**end].link_up(self.made));
        }
        self.set_neighbours(links);
    }

    fn set_neighbours(&mut self, links: &[(usize, usize)]) {
        let ends: BTreeSet<usize> = links.iter().flat_map(|(a, b)| [*a, *b]).collect();
        for i in ends {
            let near: Vec<_> = self.near(i).map(|near| (identity(near).name(), 1)).collect();
            self.switches[i].set_neighbours(near);
            self.act(i);
        }
    }

    /// Does what a daemon does after each event.
    fn act(&mut self, i: usize) {
        self.switches[i].tick(self.now);
        for Batch { id, states } in self.switches[i].batches(self.now) {
            let ends = self.cables.iter().find(|(_, link)| **link == id.link);
            let ((a, b), _) = ends.expect("batches are for links that are up");
            let to = if *a == i { *b } else { *a };
            self.sent.insert(Key { from: i, to, batch: id }, states);
        }
    }

    /// Returns the time of the next timer, if that is soon.
    fn wait(&self) -> Option<Duration> {
        let next = self.switches.iter().filter_map(|switch| switch.next_tick(self.now)).min()?;
        (next <= self.now + LONGEST_WAIT).then_some(next.max(self.now))
    }

    fn is_quiet(&self) -> bool {
        self.sent.is_empty() && self.wait().is_none()
    }

    /// Returns whether all paths are those of the links that are up, without loop or black hole.
    fn has_converged(&self) -> bool {
        let mut ends = (0..SWITCHES).flat_map(|from| (0..SWITCHES).map(move |to| (from, to)));
        ends.all(|(from, to)| {
            let hops = self.hops(from, to);
            let costs = &self.switches[from].paths().costs;
            costs.get(&identity(to).name()).copied() == hops && (hops.is_none() || self.follow(from, to) == hops)
        })
    }

    /// Returns the hops of the shortest path over links that are up.
    fn hops(&self, from: usize, to: usize) -> Option<u64> {
        let mut reached = BTreeSet::from([from]);
        for hops in 0..SWITCHES as u64 {
            if reached.contains(&to) {
                return Some(hops);
            }
            let next: Vec<_> = reached.iter().flat_map(|at| self.near(*at)).collect();
            reached.extend(next);
        }
        None
    }

    /// Returns the hops that a frame takes by the masks of the switches, if it arrives.
    fn follow(&self, from: usize, to: usize) -> Option<u64> {
        let mut at = from;
        for hops in 0..SWITCHES as u64 {
            if at == to {
                return Some(hops);
            }
            let mut near = self.near(at);
            let reach = &self.switches[at].paths().reach;
            at = near.find(|near| reach.get(&identity(*near).name()).is_some_and(|bits| bits & 1 << to != 0))?;
        }
        None
    }

    fn near(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        let near = move |(a, b): &(usize, usize)| (*a == i).then_some(*b).or((*b == i).then_some(*a));
        self.cables.keys().filter_map(near)
    }
}

fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..SWITCHES).flat_map(|a| (a + 1..SWITCHES).map(move |b| (a, b)))
}

fn switch(i: usize, run: u64) -> Topology {
    let mut switch = Topology::new(identity(i), run);
    switch.set_bit(Some(i as u8));
    switch
}

/// Returns the same identities in each run, so that ties are decided alike.
fn identity(i: usize) -> Identity {
    thread_local! {
        static ALL: Vec<Identity> = (1..=SWITCHES as u8).map(|i| {
            Identity::new(SigningKey::from_secret_bytes(&[i; 32]).expect("a scalar"), "switch")
        }).collect();
    }
    ALL.with(|all| all[i].clone())
}
