//! What one switch's FIB should hold, and the pushes that bring it there: deltas while it follows, the whole in parts
//! after every (re)connect. Pure state; the RIB fills it and sends what [`Fib::next`] returns.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp::control::{Extent, FibPush, Route};
use gdp_wire::Name;

/// Names in one push.
const NAMES_PER_PUSH: usize = 400;

/// Bytes of the routes in one push; a message has at most 64 KiB, and the rest is for what encloses them.
const ROUTES_SIZE: usize = 56 * 1024;

/// What an encoded route has without endpoints, and for each of them: names, field names.
const ROUTE_SIZE: usize = 144;
const ENDPOINT_SIZE: usize = 34;

/// How long after a push that failed the switch is sent its whole FIB.
const RETRY: Duration = Duration::from_millis(500);

/// The desired FIB of one switch, and how far the switch is known to hold it.
#[derive(Debug)]
pub struct Fib {
    routes: BTreeMap<[u8; 32], Route>,
    /// Names whose desired route is not what was last sent.
    dirty: BTreeSet<[u8; 32]>,
    generation: u64,
    phase: Phase,
    /// The push that has not been answered.
    in_flight: Option<InFlight>,
    /// Why the data plane of the switch holds only part of what was pushed.
    lacking: Option<String>,
}

/// What a push says besides routes; as in [`FibPush`].
#[derive(Clone, Debug)]
pub struct About {
    pub switch: Name,
    pub run: u64,
    pub settling: bool,
    pub own_bit: u8,
}

#[derive(Debug)]
struct InFlight {
    generation: u64,
    names: BTreeSet<[u8; 32]>,
}

/// What became of a push.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pushed {
    Done,
    /// The switch follows, but its data plane has no room for all of it: why.
    Partly(String),
    /// Not carried out, or nobody knows.
    Failed,
}

#[derive(Debug, PartialEq, Eq)]
enum Phase {
    /// The switch gets its whole FIB: next is this part, of the names above this one.
    Full { part: u32, after: Option<[u8; 32]> },
    /// The switch holds everything but what is dirty.
    Following,
    /// A push failed; try again from this time on.
    Failed { retry: Duration },
}

impl Default for Fib {
    fn default() -> Self {
        Self {
            routes: BTreeMap::new(),
            dirty: BTreeSet::new(),
            generation: 0,
            phase: Phase::Full { part: 0, after: None },
            in_flight: None,
            lacking: None,
        }
    }
}

impl Fib {
    /// Makes `route` the desired one of its name, or none.
    pub fn set(&mut self, name: &Name, route: Option<Route>) {
        let key = name.to_bytes();
        if self.routes.get(&key) != route.as_ref() {
            self.dirty.insert(key);
        }
        match route {
            Some(route) => self.routes.insert(key, route),
            None => self.routes.remove(&key),
        };
    }

    /// Sends the whole again: the switch is new or was away, or gets another bit. An answer that is still out no longer counts.
    pub fn restart(&mut self) {
        self.phase = Phase::Full { part: 0, after: None };
        self.in_flight = None;
    }

    /// The next push, unless one is out or there is nothing to say.
    pub fn next(&mut self, now: Duration, about: About) -> Option<FibPush> {
        if self.in_flight.is_some() {
            return None;
        }
        if matches!(self.phase, Phase::Failed { retry } if now >= retry) {
            self.restart();
        }
        let (extent, set, remove) = match &mut self.phase {
            Phase::Failed { .. } => return None,
            Phase::Full { part, after } => {
                let (set, last) = page(&self.routes, *after);
                // This page settles what is dirty on it; changes before it stay for a delta.
                let end = if last { None } else { set.last().map(|r| r.name.to_bytes()) };
                let start = *after;
                self.dirty.retain(|name| start.is_some_and(|s| *name <= s) || end.is_some_and(|e| *name > e));
                let extent = Extent::Full { part: *part, last };
                self.phase = if last { Phase::Following } else { Phase::Full { part: *part + 1, after: end } };
                (extent, set, Vec::new())
            }
            Phase::Following => {
                if self.dirty.is_empty() {
                    return None;
                }
                let (mut set, mut remove, mut room) = (Vec::new(), Vec::new(), Room::new());
                while let Some(name) = self.dirty.first() {
                    let route = self.routes.get(name);
                    if !room.takes(route) {
                        break;
                    }
                    match route {
                        Some(route) => set.push(route.clone()),
                        None => remove.push(Name::from_bytes(*name)),
                    }
                    self.dirty.pop_first();
                }
                (Extent::Delta, set, remove)
            }
        };
        self.generation += 1;
        let names = set.iter().map(|route| &route.name).chain(&remove).map(|name| name.to_bytes()).collect();
        self.in_flight = Some(InFlight { generation: self.generation, names });
        let About { switch, run, settling, own_bit } = about;
        Some(FibPush { switch, run, settling, generation: self.generation, extent, own_bit, set, remove })
    }

    /// What became of the push of this generation. If it failed, the whole is sent, a little later.
    pub fn answered(&mut self, now: Duration, generation: u64, outcome: Pushed) {
        if self.in_flight.as_ref().is_none_or(|push| push.generation != generation) {
            return;
        }
        self.in_flight = None;
        match outcome {
            Pushed::Done => self.lacking = None,
            Pushed::Partly(reason) => self.lacking = Some(reason),
            Pushed::Failed => self.phase = Phase::Failed { retry: now + RETRY },
        }
    }

    /// Whether the switch has answered what there is to say of this name; or has failed to, so that waiting is of no use.
    pub fn is_settled(&self, name: &[u8; 32]) -> bool {
        let sent = match &self.phase {
            Phase::Failed { .. } => return true,
            Phase::Following => true,
            Phase::Full { after, .. } => after.is_some_and(|after| *name <= after),
        };
        sent && !self.dirty.contains(name) && self.in_flight.as_ref().is_none_or(|push| !push.names.contains(name))
    }

    /// Why the data plane of the switch has no room for more, as it last said.
    pub fn lacking(&self) -> Option<&str> {
        self.lacking.as_deref()
    }

    /// When to ask for the next push again, if nothing else happens.
    pub fn retry_at(&self) -> Option<Duration> {
        match self.phase {
            Phase::Failed { retry } => Some(retry),
            _ => None,
        }
    }

    /// All that the switch should hold.
    pub fn routes(&self) -> impl Iterator<Item = &Route> {
        self.routes.values()
    }
}

/// What is left of a push.
struct Room {
    names: usize,
    bytes: usize,
}

impl Room {
    fn new() -> Self {
        Self { names: NAMES_PER_PUSH, bytes: ROUTES_SIZE }
    }

    /// Makes room for a route, or for the name of one that is removed. An empty push takes any: a name has at most as many
    /// readers at a switch as that has links, and 256 writers.
    fn takes(&mut self, route: Option<&Route>) -> bool {
        let ends = |route: &Route| route.locals.len() + route.writers.len() + route.arrives_by.len();
        let size = ROUTE_SIZE + route.map_or(0, ends) * ENDPOINT_SIZE;
        if self.names == 0 || (self.bytes < size && self.names < NAMES_PER_PUSH) {
            return false;
        }
        self.names -= 1;
        self.bytes = self.bytes.saturating_sub(size);
        true
    }
}

/// The routes above `after` that one push takes, and whether they are the last.
fn page(routes: &BTreeMap<[u8; 32], Route>, after: Option<[u8; 32]>) -> (Vec<Route>, bool) {
    use std::ops::Bound::{Excluded, Unbounded};
    let mut rest = routes.range((after.map_or(Unbounded, Excluded), Unbounded)).map(|(_, route)| route).peekable();
    let mut room = Room::new();
    let mut set = Vec::new();
    while let Some(route) = rest.next_if(|route| room.takes(Some(route))) {
        set.push(route.clone());
    }
    (set, rest.peek().is_none())
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::from_secs(5);

    #[test]
    fn the_whole_comes_first_and_then_what_changes() {
        let (mut fib, mut switch) = (Fib::default(), Switch::default());
        fib.set(&name(1), Some(route(1, 2)));
        assert!(switch.follow(&mut fib));
        assert_eq!(switch.pushes, 1);
        assert!(!switch.follow(&mut fib), "nothing more to say");
        fib.set(&name(1), Some(route(1, 2)));
        assert!(!switch.follow(&mut fib), "the same route is no change");
        fib.set(&name(1), None);
        fib.set(&name(2), Some(route(2, 4)));
        assert!(switch.follow(&mut fib));
        assert_eq!((switch.pushes, switch.routes.len()), (2, 1));
        switch.agrees(&fib);
    }

    #[test]
    fn one_push_is_out_at_a_time_and_a_failure_sends_the_whole() {
        let mut fib = Fib::default();
        fib.set(&name(1), Some(route(1, 1)));
        let push = fib.next(NOW, about()).unwrap();
        fib.set(&name(2), Some(route(2, 1)));
        assert_eq!(fib.next(NOW, about()), None);
        fib.answered(NOW, push.generation + 1, Pushed::Done);
        assert_eq!(fib.next(NOW, about()), None, "an answer to something else");
        fib.answered(NOW, push.generation, Pushed::Failed);
        assert_eq!(fib.next(NOW, about()), None, "not at once");
        let retry = fib.retry_at().unwrap();
        let push = fib.next(retry, about()).unwrap();
        assert_eq!((push.extent, push.set.len()), (Extent::Full { part: 0, last: true }, 2));
    }

    #[test]
    fn a_name_is_settled_once_the_push_that_says_it_is_answered() {
        let mut fib = Fib::default();
        let key = |i| name(i).to_bytes();
        (1..=NAMES_PER_PUSH as u64 + 1).for_each(|i| fib.set(&name(i), Some(route(i, 1))));
        assert!(!fib.is_settled(&key(1)));
        let push = fib.next(NOW, about()).unwrap();
        assert!(!fib.is_settled(&key(1)), "sent and not answered");
        fib.answered(NOW, push.generation, Pushed::Done);
        assert!(fib.is_settled(&key(1)) && !fib.is_settled(&key(NAMES_PER_PUSH as u64 + 1)), "of the first part only");
        let push = fib.next(NOW, about()).unwrap();
        fib.set(&name(1), None);
        fib.answered(NOW, push.generation, Pushed::Partly("full".into()));
        assert_eq!(fib.lacking(), Some("full"));
        assert!(fib.is_settled(&key(2)) && !fib.is_settled(&key(1)), "it changed again");
        let push = fib.next(NOW, about()).unwrap();
        assert_eq!(push.extent, Extent::Delta, "a switch without room is not sent the whole again");
        fib.answered(NOW, push.generation, Pushed::Done);
        assert!(fib.is_settled(&key(1)) && fib.lacking().is_none());
    }

    #[test]
    fn whatever_changes_during_a_long_transfer_arrives() {
        let mut random = 1u64;
        let mut next = move |bound: u64| {
            random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (random >> 33) % bound
        };
        for round in 0..20 {
            let (mut fib, mut switch) = (Fib::default(), Switch::default());
            switch.routes.insert(name(99_999).to_bytes(), route(99_999, 1));
            for i in 0..1500 + 10 * round {
                fib.set(&name(i), Some(route(i, 1)));
            }
            loop {
                let more = switch.follow(&mut fib);
                if !more && switch.pushes >= 10 {
                    break;
                }
                if switch.pushes < 10 {
                    for _ in 0..50 {
                        let i = next(2500);
                        fib.set(&name(i), (next(2) == 0).then(|| route(i, next(64))));
                    }
                }
            }
            switch.agrees(&fib);
        }
    }

    #[test]
    fn a_route_with_as_many_readers_as_a_switch_has_links_fits_a_message() {
        let mut fib = Fib::default();
        let readers: Vec<Name> = (0..gdp_wire::table::MAX_LINKS.into()).map(name).collect();
        let writers = readers[..256].to_vec();
        for i in 0..3 {
            fib.set(&name(i), Some(Route { locals: readers.clone(), writers: writers.clone(), ..route(i, 1) }));
        }
        let mut pushes = 0;
        while let Some(push) = fib.next(NOW, about()) {
            pushes += 1;
            let generation = push.generation;
            gdp::control::encode(&gdp::control::Request::Fib(push)).expect("it fits");
            fib.answered(NOW, generation, Pushed::Done);
        }
        assert_eq!(pushes, 3);
    }

    #[test]
    fn a_push_of_names_with_many_writers_fits_a_message() {
        let mut fib = Fib::default();
        let writers: Vec<Name> = (0..60).map(name).collect();
        for i in 0..100 {
            fib.set(&name(i), Some(Route { writers: writers.clone(), ..route(i, 1) }));
        }
        let mut sent = 0;
        while let Some(push) = fib.next(NOW, about()) {
            sent += push.set.len();
            let generation = push.generation;
            gdp::control::encode(&gdp::control::Request::Fib(push)).expect("it fits");
            fib.answered(NOW, generation, Pushed::Done);
            // The second half as changes.
            if sent == 100 {
                (0..100).for_each(|i| fib.set(&name(i), Some(Route { writers: writers.clone(), ..route(i, 2) })));
            }
        }
        assert_eq!(sent, 200);
    }

    /// A switch as the daemon implements it: marks, sweeps, insists on generations.
    #[derive(Default)]
    struct Switch {
        routes: BTreeMap<[u8; 32], Route>,
        marked: BTreeSet<[u8; 32]>,
        generation: u64,
        pushes: usize,
    }

    impl Switch {
        fn follow(&mut self, fib: &mut Fib) -> bool {
            let Some(push) = fib.next(NOW, about()) else { return false };
            self.pushes += 1;
            assert!(push.set.len() + push.remove.len() <= NAMES_PER_PUSH);
            if push.extent == Extent::Delta {
                assert_eq!(push.generation, self.generation + 1);
            }
            self.generation = push.generation;
            if matches!(push.extent, Extent::Full { part: 0, .. }) {
                self.marked = self.routes.keys().copied().collect();
            }
            for route in push.set {
                self.marked.remove(&route.name.to_bytes());
                self.routes.insert(route.name.to_bytes(), route);
            }
            for name in push.remove {
                self.routes.remove(&name.to_bytes());
            }
            if matches!(push.extent, Extent::Full { last: true, .. }) {
                let swept = std::mem::take(&mut self.marked);
                self.routes.retain(|name, _| !swept.contains(name));
            }
            fib.answered(NOW, push.generation, Pushed::Done);
            true
        }

        fn agrees(&self, fib: &Fib) {
            assert!(self.routes.values().eq(fib.routes()));
        }
    }

    fn name(i: u64) -> Name {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&i.to_be_bytes());
        Name::from_bytes(bytes)
    }

    fn about() -> About {
        About { switch: name(9), run: 1, settling: false, own_bit: 0 }
    }

    fn route(i: u64, bits: u64) -> Route {
        Route { name: name(i), egress_bits: bits, ..Route::default() }
    }
}
