//! Switches with links between them, in simulated time: floods are lost, delayed and overtake each
//! other, links flap, switches restart with a clock that went back, and frames cross all that.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use gdp_core::identity::Identity;

use super::*;

const MS: Duration = Duration::from_millis(1);

/// Hops that a frame goes at most, as the data planes begin with.
const HOP_LIMIT: usize = 32;

#[test]
fn a_ring_of_five_heals_when_its_active_link_is_cut() {
    let mut w = World::ring(5);
    w.run_for(Duration::from_secs(1));
    w.check_converged();
    assert_eq!(w.route(0, 2), [0, 1, 2]);
    w.cut(0, 1);
    let cut_at = w.now;
    while w.route(0, 2) != [0, 4, 3, 2] {
        w.step();
    }
    let took = w.now - cut_at;
    assert!(took < 100 * MS, "{took:?} for the news to go round");
    w.run_for(Duration::from_secs(1));
    w.check_converged();
    w.join(0, 1, 1);
    w.run_for(Duration::from_secs(1));
    w.check_converged();
    assert_eq!(w.route(0, 2), [0, 1, 2]);
}

#[test]
fn control_goes_round_a_switch_whose_daemon_is_dead_and_frames_do_not() {
    let mut w = World::ring(5);
    w.switches[3].topology.set_rib(true);
    w.act(3);
    w.run_for(Duration::from_secs(1));
    let run = |w: &World, at: usize| w.switches[at].topology.rib();
    assert_eq!((w.control_route(0, 3), run(&w, 0)), (vec![0, 4, 3], Some((w.name(3), 1003))));
    for near in [0, 3] {
        let dead = w.name(4);
        w.switches[near].topology.set_silent([dead]);
        w.act(near);
    }
    w.run_for(Duration::from_secs(1));
    assert_eq!((w.control_route(0, 3), w.route(0, 3)), (vec![0, 1, 2, 3], vec![0, 4, 3]));
    // The daemon of the RIB's switch, as well.
    let dead = w.name(3);
    w.switches[2].topology.set_silent([dead]);
    w.act(2);
    w.run_for(Duration::from_secs(1));
    assert_eq!((run(&w, 0), w.control_route(0, 3)), (None, vec![0]));
    assert_eq!(w.route(0, 3), [0, 4, 3]);
}

#[test]
fn links_into_other_domains_are_known_to_all_who_reach_them() {
    let mut w = World::ring(5);
    let [domain, switch] = [8, 9].map(|i| Name::from_bytes([i; 32]));
    let border = Adjoining { domain, switch, cost: 0, transit: true, ours_transit: false, parent: None };
    let known = |w: &World| {
        let borders = w.switches[0].topology.borders();
        borders.map(|(at, border)| (w.index(&at), border.cost, border.switch)).collect::<Vec<_>>()
    };
    let to_itself = Adjoining { switch: w.name(2), ..border.clone() };
    w.switches[2].topology.set_borders([border.clone(), to_itself]);
    w.act(2);
    w.run_for(Duration::from_secs(1));
    assert_eq!(known(&w), [(2, 1, switch)], "it costs something, and none leads to the switch itself");
    w.switches[2].topology.set_borders([Adjoining { cost: 7, ..border }]);
    w.act(2);
    w.run_for(Duration::from_secs(1));
    assert_eq!(known(&w), [(2, 7, switch)]);
    w.cut(1, 2);
    w.cut(2, 3);
    w.run_for(Duration::from_secs(1));
    assert_eq!(known(&w), []);
}

#[test]
fn two_islands_that_meet_learn_all_of_each_other() {
    let mut w = World::new(6);
    for (a, b) in [(0, 1), (1, 2), (3, 4), (4, 5)] {
        w.join(a, b, 1);
    }
    w.run_for(Duration::from_secs(1));
    assert_eq!(w.route(0, 5), [0], "no way yet");
    w.join(2, 3, 1);
    w.run_for(Duration::from_secs(1));
    assert_eq!(w.route(0, 5), [0, 1, 2, 3, 4, 5]);
    w.check_converged();
}

#[test]
fn a_switch_that_lost_its_number_goes_above_its_older_self() {
    let mut w = World::ring(5);
    w.run_for(Duration::from_secs(1));
    let before = w.switches[3].topology.own.version;
    // Its clock went back, and it has another cost to state.
    w.restart(3, 7);
    w.join(3, 4, 50);
    w.run_for(Duration::from_secs(1));
    w.check_converged();
    assert!(w.switches[3].topology.own.version > before);
    assert_eq!(w.route(4, 3), [4, 0, 1, 2, 3], "its newest statement counts everywhere");
}

#[test]
fn statements_are_renewed_and_those_of_the_dead_end() {
    let mut w = World::ring(5);
    w.run_for(Duration::from_secs(3 * u64::from(LIFETIME)));
    w.check_converged();
    assert!(w.switches.iter().all(|s| s.topology.states().count() == 5), "they are renewed");
    w.cut(1, 2);
    w.cut(2, 3);
    w.run_for(Duration::from_secs(1));
    assert_eq!(w.route(0, 2), [0]);
    w.run_for(Duration::from_secs(u64::from(LIFETIME)));
    assert!((0..5).filter(|i| *i != 2).all(|i| w.switches[i].topology.states().count() == 4), "nobody hears of it");
    assert_eq!(w.switches[2].topology.states().count(), 1);
}

#[test]
fn a_flapping_link_is_stated_less_and_less_often() {
    let mut w = World::ring(5);
    w.run_for(Duration::from_secs(20));
    let before = w.switches[0].topology.own.version.1;
    let mut ways = 0;
    for _ in 0..600 {
        w.cut(0, 1);
        w.run_for(60 * MS);
        assert_ne!(w.route(0, 1), [0, 1], "that it is gone is stated at once");
        w.join(0, 1, 1);
        w.run_for(40 * MS);
        ways += usize::from(w.route(0, 1) == [0, 1]);
    }
    let stated = w.switches[0].topology.own.version.1 - before;
    assert!((10..60).contains(&stated), "{stated} statements in a minute");
    assert!(ways < 20, "it was used {ways} times");
    w.run_for(Duration::from_secs(20));
    w.check_converged();
    w.cut(0, 1);
    let at = w.now;
    w.run_for(MS);
    assert_eq!(w.switches[0].topology.own.stated_at, Some(at), "after a quiet time at once");
}

#[test]
fn a_link_that_one_end_avoids_is_left_by_all_and_used_only_where_there_is_no_other() {
    let mut w = World::ring(5);
    w.run_for(Duration::from_secs(1));
    assert_eq!(w.route(0, 2), [0, 1, 2]);
    let (left, right) = (w.name(4), w.name(1));
    let avoid = |w: &mut World, cost: u32| {
        w.switches[0].topology.set_neighbours([(left, 1), (right, cost)]);
        w.act(0);
    };
    // Also shortly after another statement, and again and again.
    for _ in 0..20 {
        avoid(&mut w, AVOIDED);
        w.run_for(100 * MS);
        assert_eq!((w.route(0, 2), w.route(2, 0)), (vec![0, 4, 3, 2], vec![2, 3, 4, 0]));
        avoid(&mut w, 1);
        w.run_for(50 * MS);
    }
    avoid(&mut w, AVOIDED);
    w.run_for(100 * MS);
    w.cut(0, 4);
    w.switches[0].topology.set_neighbours([(right, AVOIDED)]);
    w.act(0);
    w.run_for(Duration::from_secs(1));
    assert_eq!((w.route(0, 2), w.route(4, 0)), (vec![0, 1, 2], vec![4, 3, 2, 1, 0]));
}

#[test]
fn what_no_switch_signed_is_refused() {
    let mut w = World::ring(3);
    w.run_for(Duration::from_secs(1));
    let told = |w: &World| w.switches[0].topology.database.flooded(w.now, &w.name(1)).unwrap();
    let (own, other) = (told(&w), w.switches[2].identity.clone());
    assert!(own.verify().is_ok());
    let stolen = Flooded { proof: other.proof(), ..own.clone() };
    assert!(matches!(Verified::new(stolen), Err(CertError::WrongKey { .. })));
    let claims = LinkState { number: 1000, ..own.state.claims_unverified().unwrap() };
    let forged = Flooded { state: issue(other.key(), &claims).unwrap(), ..own.clone() };
    assert!(matches!(Verified::new(forged.clone()), Err(CertError::WrongKey { .. })));
    let of_another = Flooded { proof: other.proof(), ..forged };
    assert!(matches!(Verified::new(of_another), Err(CertError::WrongName { .. })));
    assert_eq!(w.switches[0].topology.news(9, vec![own]).unwrap(), [], "what is known is not verified again");
}

#[test]
fn on_random_graphs_all_agree_in_the_end_and_frames_neither_multiply_nor_go_round_for_ever() {
    let mut totals = [0; 3];
    for seed in 0..12 {
        let count = 3 + seed as usize;
        let mut w = World::new(count);
        w.random = Random(seed * 77 + 1);
        (w.loss, w.slowest) = (seed % 4, 40);
        let mut edges: BTreeSet<(usize, usize)> = (1..count).map(|i| (w.random.index(i), i)).collect();
        for _ in 0..count {
            let (a, b) = (w.random.index(count), w.random.index(count));
            if a != b {
                edges.insert((a.min(b), a.max(b)));
            }
        }
        let edges: Vec<_> = edges.into_iter().collect();
        let costs: Vec<u32> = edges.iter().map(|_| 1 + w.random.below(9) as u32).collect();
        edges.iter().zip(&costs).for_each(|((a, b), cost)| w.join(*a, *b, *cost));
        w.run_for(Duration::from_secs(2));
        for round in 0..60 {
            let which = w.random.index(edges.len());
            let (a, b) = edges[which];
            match w.random.below(8) {
                0 => {
                    let run = w.random.below(1000);
                    w.restart(a, run);
                }
                1 | 2 => w.join(a, b, 1 + (round % 9)),
                _ if w.cables.contains_key(&(a, b)) => w.cut(a, b),
                _ => w.join(a, b, costs[which]),
            }
            let pause = w.random.below(120);
            w.run_for(MS * pause as u32);
            let from = w.random.index(count);
            w.send(from);
        }
        // Where three eighths of what is said are lost, the last word is sometimes said again after
        // half a minute.
        w.run_for(Duration::from_secs(45));
        w.check_converged();
        let before = w.fates;
        (0..count).for_each(|from| w.send(from));
        w.run_for(Duration::from_secs(5));
        let now = w.fates;
        assert_eq!((now.looped, now.lost), (before.looped, before.lost), "seed {seed}: no lasting loop or black hole");
        totals = [totals[0] + now.delivered, totals[1] + now.lost, totals[2] + now.looped];
    }
    let [delivered, lost, looped] = totals;
    assert!(
        delivered > 2 * lost && delivered > 50 * looped,
        "{delivered} delivered, {lost} lost, {looped} ended by the hop limit"
    );
    assert!(lost > 0, "there were changes that frames noticed");
}

struct World {
    now: Duration,
    switches: Vec<Switch>,
    /// The links, by their ends, with their costs: the id is a link's number at both ends.
    cables: BTreeMap<(usize, usize), (u32, u32)>,
    made: u32,
    events: BinaryHeap<Reverse<(Duration, u64, Event)>>,
    count: u64,
    random: Random,
    /// Of eight messages so many are lost, or their answers; and how long the others take at most,
    /// in ms.
    loss: u64,
    slowest: u64,
    fates: Fates,
    /// Frames that were delivered, and where.
    delivered: BTreeSet<(u64, usize)>,
    frames: u64,
}

struct Switch {
    identity: Identity,
    topology: Topology,
}

#[derive(Clone, Copy, Debug, Default)]
struct Fates {
    delivered: usize,
    /// No neighbour leads to the bit, or the link was cut.
    lost: usize,
    looped: usize,
}

#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Flood {
        to: usize,
        from: usize,
        batch: BatchId,
        states: Vec<Told>,
    },
    Answer {
        to: usize,
        batch: BatchId,
        arrived: bool,
    },
    /// One copy of a frame.
    Frame {
        number: u64,
        at: usize,
        bits: u64,
        hops: usize,
    },
}

/// A statement on its way. Two are never compared, because events are numbered.
#[derive(Debug)]
struct Told(Flooded);

impl PartialEq for Told {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Told {}

impl PartialOrd for Told {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Told {
    fn cmp(&self, _: &Self) -> std::cmp::Ordering {
        std::cmp::Ordering::Equal
    }
}

impl World {
    fn new(count: usize) -> Self {
        let switches = (0..count).map(|i| {
            let identity = Identity::generate("switch").unwrap();
            let mut topology = Topology::new(identity.clone(), 1000 + i as u64);
            topology.set_bit(Some(i as u8));
            Switch { identity, topology }
        });
        let mut w = Self {
            now: Duration::from_secs(100),
            switches: switches.collect(),
            cables: BTreeMap::new(),
            made: 0,
            events: BinaryHeap::new(),
            count: 0,
            random: Random(3),
            loss: 0,
            slowest: 4,
            fates: Fates::default(),
            delivered: BTreeSet::new(),
            frames: 0,
        };
        (0..count).for_each(|i| w.act(i));
        w
    }

    fn ring(count: usize) -> Self {
        let mut w = Self::new(count);
        (0..count).for_each(|i| w.join(i, (i + 1) % count, 1));
        w
    }

    fn name(&self, i: usize) -> Name {
        self.switches[i].identity.name()
    }

    fn index(&self, name: &Name) -> usize {
        (0..self.switches.len()).find(|i| self.name(*i) == *name).unwrap()
    }

    /// Makes a link, or changes its cost.
    fn join(&mut self, a: usize, b: usize, cost: u32) {
        let ends = (a.min(b), a.max(b));
        let link = match self.cables.get(&ends) {
            Some((link, _)) => *link,
            None => {
                self.made += 1;
                [a, b].into_iter().for_each(|end| self.switches[end].topology.link_up(self.made));
                self.made
            }
        };
        self.cables.insert(ends, (link, cost));
        self.adjacent(a);
        self.adjacent(b);
    }

    /// Both ends notice at once.
    fn cut(&mut self, a: usize, b: usize) {
        let Some((link, _)) = self.cables.remove(&(a.min(b), a.max(b))) else { return };
        for end in [a, b] {
            self.switches[end].topology.link_down(link);
            self.adjacent(end);
        }
    }

    /// The switch forgets everything, and its neighbours make new links to it.
    fn restart(&mut self, i: usize, run: u64) {
        let links: Vec<_> = self.cables.iter().filter(|((a, b), _)| *a == i || *b == i).collect();
        let links: Vec<_> = links.into_iter().map(|(ends, (_, cost))| (*ends, *cost)).collect();
        links.iter().for_each(|((a, b), _)| self.cut(*a, *b));
        let bit = self.switches[i].topology.bit();
        self.switches[i].topology = Topology::new(self.switches[i].identity.clone(), run);
        self.switches[i].topology.set_bit(bit);
        links.into_iter().for_each(|((a, b), cost)| self.join(a, b, cost));
        self.act(i);
    }

    fn adjacent(&mut self, i: usize) {
        let near = self.cables.iter().filter_map(|((a, b), (_, cost))| match i {
            i if i == *a => Some((self.name(*b), *cost)),
            i if i == *b => Some((self.name(*a), *cost)),
            _ => None,
        });
        let near: Vec<_> = near.collect();
        self.switches[i].topology.set_neighbours(near);
        self.act(i);
    }

    /// Does what a switch has to do now.
    fn act(&mut self, i: usize) {
        let (now, topology) = (self.now, &mut self.switches[i].topology);
        topology.tick(now);
        for Batch { id, states } in topology.batches(now) {
            let ends = self.cables.iter().find(|(_, (link, _))| *link == id.link).map(|(ends, _)| *ends);
            let Some((a, b)) = ends else { continue };
            let to = if a == i { b } else { a };
            if self.is_lost() {
                self.after(200, Event::Answer { to: i, batch: id, arrived: false });
            } else {
                let wait = self.delay();
                let states = states.into_iter().map(Told).collect();
                self.after(wait, Event::Flood { to, from: i, batch: id, states });
            }
        }
    }

    fn is_lost(&mut self) -> bool {
        self.random.below(8) < self.loss
    }

    fn delay(&mut self) -> u64 {
        1 + self.random.below(self.slowest)
    }

    fn after(&mut self, ms: u64, event: Event) {
        self.count += 1;
        self.events.push(Reverse((self.now + MS * ms as u32, self.count, event)));
    }

    fn run_for(&mut self, time: Duration) {
        let end = self.now + time;
        while self.next().is_some_and(|at| at <= end) {
            self.step();
        }
        self.now = end;
    }

    fn next(&self) -> Option<Duration> {
        let ticks = self.switches.iter().filter_map(|s| s.topology.next_tick(self.now));
        ticks.chain(self.events.peek().map(|Reverse((at, ..))| *at)).min()
    }

    /// To the next moment at which something happens.
    fn step(&mut self) {
        let Some(next) = self.next() else { return };
        self.now = self.now.max(next);
        while self.events.peek().is_some_and(|Reverse((at, ..))| *at <= self.now) {
            if let Some(Reverse((.., event))) = self.events.pop() {
                self.happen(event);
            }
        }
        for i in 0..self.switches.len() {
            if self.switches[i].topology.next_tick(self.now).is_some_and(|at| at <= self.now) {
                self.act(i);
            }
        }
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Flood { to, from, batch, states } => {
                if !self.cables.values().any(|(link, _)| *link == batch.link) {
                    return;
                }
                let states = states.into_iter().map(|told| told.0).collect();
                let topology = &mut self.switches[to].topology;
                let news = topology.news(batch.link, states).unwrap();
                let news = news.into_iter().map(|flooded| Verified::new(flooded).unwrap()).collect();
                topology.learn(self.now, batch.link, news);
                self.act(to);
                let (arrived, wait) = (!self.is_lost(), self.delay());
                self.after(if arrived { wait } else { 200 }, Event::Answer { to: from, batch, arrived });
            }
            Event::Answer { to, batch, arrived } => {
                self.switches[to].topology.answered(self.now, batch, arrived);
                self.act(to);
            }
            Event::Frame { number, at, bits, hops } => self.forward(number, at, bits, hops),
        }
    }

    /// Sends a frame to all switches.
    fn send(&mut self, from: usize) {
        self.frames += 1;
        self.forward(self.frames, from, (1 << self.switches.len()) - 1, 0);
    }

    /// As a data plane does it.
    fn forward(&mut self, number: u64, at: usize, bits: u64, hops: usize) {
        if bits & 1 << at != 0 {
            assert!(self.delivered.insert((number, at)), "a frame came twice");
            self.fates.delivered += 1;
        }
        let bits = bits & !(1 << at);
        if hops == HOP_LIMIT {
            self.fates.looped += bits.count_ones() as usize;
            return;
        }
        let mut left = bits;
        for (next, mask) in self.switches[at].topology.paths().reach.clone() {
            let (next, onward) = (self.index(&next), bits & mask);
            let is_there = self.cables.contains_key(&(at.min(next), at.max(next)));
            if onward != 0 && is_there {
                assert_eq!(onward & !left, 0, "a bit goes two ways");
                left &= !onward;
                let wait = self.delay();
                self.after(wait, Event::Frame { number, at: next, bits: onward, hops: hops + 1 });
            }
        }
        // Those that nothing leads to, of those there is a way to.
        let there = (0..self.switches.len()).filter(|to| left & 1 << to != 0 && self.connected(at).contains(to));
        self.fates.lost += there.count();
    }

    /// The switches a frame passes.
    fn route(&self, from: usize, to: usize) -> Vec<usize> {
        let mut route = vec![from];
        while let Some(at) = route.last().copied().filter(|at| *at != to) {
            let paths = self.switches[at].topology.paths();
            let next = paths.reach.iter().find(|(_, bits)| *bits & 1 << to != 0).map(|(next, _)| self.index(next));
            match next {
                Some(next) if route.len() <= self.switches.len() => route.push(next),
                Some(_) => panic!("a loop: {route:?}"),
                None => break,
            }
        }
        route
    }

    /// The switches that control passes.
    fn control_route(&self, from: usize, to: usize) -> Vec<usize> {
        let mut route = vec![from];
        while let Some(at) = route.last().copied().filter(|at| *at != to && route.len() <= self.switches.len()) {
            let Some(next) = self.switches[at].topology.paths().next.get(&self.name(to)) else { break };
            route.push(self.index(next));
        }
        route
    }

    /// Every switch reaches exactly those that cables lead to, at the same cost from both ends, and
    /// nothing is left to say.
    fn check_converged(&self) {
        for a in 0..self.switches.len() {
            let connected = self.connected(a);
            for b in 0..self.switches.len() {
                assert_eq!(self.route(a, b).last() == Some(&b), connected.contains(&b), "from {a} to {b}");
                assert_eq!(
                    self.control_route(a, b),
                    self.route(a, b),
                    "control goes as frames do where all daemons live"
                );
                let cost = |a: usize, b: usize| self.switches[a].topology.paths().costs.get(&self.name(b)).copied();
                assert_eq!(cost(a, b), cost(b, a));
                if let Some(cost) = cost(a, b) {
                    let route = self.route(a, b);
                    let hops = route.windows(2).map(|hop| self.cables[&(hop[0].min(hop[1]), hop[0].max(hop[1]))].1);
                    assert_eq!(cost, u64::from(hops.sum::<u32>()), "the cost of what is really there");
                }
            }
        }
        assert!(self.events.is_empty(), "{:?}", self.events.len());
    }

    fn connected(&self, from: usize) -> BTreeSet<usize> {
        let (mut reached, mut fresh) = (BTreeSet::from([from]), vec![from]);
        while let Some(at) = fresh.pop() {
            for (a, b) in self.cables.keys().filter(|(a, b)| *a == at || *b == at) {
                let next = if *a == at { *b } else { *a };
                if reached.insert(next) {
                    fresh.push(next);
                }
            }
        }
        reached
    }
}

struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) % bound
    }

    fn index(&mut self, bound: usize) -> usize {
        self.below(bound as u64) as usize
    }
}
