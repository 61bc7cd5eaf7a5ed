//! Unit tests of `rib::fib`.

use std::collections::{BTreeMap, BTreeSet};

use gdp_proto::control::Extent;

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
    assert!(!fib.is_settled(&name(1).to_bytes()), "the next one may arrive");
    let retry = fib.retry_at().unwrap();
    let push = fib.next(retry, about()).unwrap();
    assert_eq!((push.extent, push.set.len()), (Extent::Full { part: 0, last: true }, 2));
    fib.answered(retry, push.generation, Pushed::Failed);
    assert!(fib.is_settled(&name(1).to_bytes()), "it is of no use to wait for this switch");
    let retry = fib.retry_at().unwrap();
    let push = fib.next(retry, about()).unwrap();
    fib.answered(retry, push.generation, Pushed::Done);
    fib.set(&name(3), Some(route(3, 1)));
    let push = fib.next(retry, about()).unwrap();
    fib.answered(retry, push.generation, Pushed::Failed);
    assert!(!fib.is_settled(&name(3).to_bytes()), "it was there meanwhile");
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
        gdp_proto::control::encode(&gdp_proto::control::Request::Fib(push)).expect("it fits");
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
        gdp_proto::control::encode(&gdp_proto::control::Request::Fib(push)).expect("it fits");
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
