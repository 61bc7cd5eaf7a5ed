//! Unit tests of `topology::paths`.

use super::*;

#[test]
fn a_chain_leads_through_its_middle() {
    let states = [state(1, 7, &[(2, 1)]), state(2, 8, &[(1, 1), (3, 1)]), state(3, 9, &[(2, 1)])];
    assert_eq!(reach(1, &states), [(2, 1 << 8 | 1 << 9)]);
    assert_eq!(reach(2, &states), [(1, 1 << 7), (3, 1 << 9)]);
    let paths = Paths::compute(name(1), states.iter());
    assert_eq!((paths.costs[&name(3)], paths.bit(&name(3)), paths.bit(&name(1))), (2, Some(9), Some(7)));
}

#[test]
fn an_adjacency_counts_only_if_both_ends_state_it() {
    let one_sided = [state(1, 1, &[(2, 1)]), state(2, 2, &[])];
    assert_eq!(reach(1, &one_sided), []);
    assert!(!Paths::compute(name(1), one_sided.iter()).reaches(&name(2)));
    assert_eq!(reach(1, &[state(1, 1, &[(2, 1)])]), [], "nor one to somebody who says nothing");
}

#[test]
fn the_cheaper_way_wins_and_switches_without_a_bit_pass_on() {
    // 1 –(1)– 2 –(1)– 3, and 1 –(5)– 3, of which one end says 2; 4 hangs on 1.
    let mut states = vec![
        state(1, 1, &[(2, 1), (3, 5), (4, 1)]),
        state(2, 2, &[(1, 1), (3, 1)]),
        state(3, 3, &[(1, 2), (2, 1)]),
        state(4, 4, &[(1, 1)]),
    ];
    assert_eq!(reach(1, &states), [(2, 1 << 2 | 1 << 3), (4, 1 << 4)]);
    states[1].bit = None;
    assert_eq!(reach(1, &states), [(2, 1 << 3), (4, 1 << 4)]);
    states[2].neighbours.pop();
    assert_eq!(reach(1, &states), [(3, 1 << 3), (4, 1 << 4)]);
    assert_eq!(reach(4, &states), [(1, 1 << 1 | 1 << 3)]);
}

#[test]
fn of_two_with_the_same_bit_the_one_that_ran_first_has_it() {
    let mut states = [state(1, 1, &[(2, 1), (3, 1)]), state(2, 5, &[(1, 1)]), state(3, 5, &[(1, 1)])];
    assert_eq!(reach(1, &states), [(2, 1 << 5)], "the lower name, if they ran as long");
    states[1].run = 2;
    assert_eq!(reach(1, &states), [(3, 1 << 5)]);
    assert_eq!(reach(2, &states), [(1, 1 << 1 | 1 << 5)], "it has none of its own then");
    states[2].neighbours.clear();
    assert_eq!(reach(1, &states), [(2, 1 << 5)], "one that nobody reaches takes it from nobody");
}

#[test]
fn each_switch_has_a_next_hop_and_the_nearest_rib_counts() {
    // A ring of four, 1 – 2 – 3 – 4 – 1; the link 3 – 4 costs more.
    let mut states = [
        state(1, 1, &[(2, 1), (4, 1)]),
        state(2, 2, &[(1, 1), (3, 1)]),
        state(3, 3, &[(2, 1), (4, 5)]),
        state(4, 4, &[(1, 1), (3, 5)]),
    ];
    states[1].bit = None;
    let paths = |states: &[LinkState], own| Paths::compute(name(own), states.iter());
    let next = |states: &[LinkState], own| {
        let next = paths(states, own).next;
        next.into_iter().map(|(to, via)| (to.as_bytes()[0], via.as_bytes()[0])).collect::<Vec<_>>()
    };
    assert_eq!(next(&states, 1), [(2, 2), (3, 2), (4, 4)], "also to one without a bit");
    assert_eq!(next(&states, 3), [(1, 2), (2, 2), (4, 2)]);
    assert_eq!(paths(&states, 1).rib, None);
    states[2].rib = true;
    assert_eq!(paths(&states, 1).rib, Some((name(3), 1)));
    states[3].rib = true;
    assert_eq!([1, 2, 3, 4].map(|own| paths(&states, own).rib.unwrap().0.as_bytes()[0]), [4, 3, 3, 4]);
    states[1].rib = true;
    assert_eq!(paths(&states, 1).rib, Some((name(2), 1)), "the lower name of two as near");
    let before = paths(&states, 1);
    states[1].run = 2;
    assert_eq!(paths(&states, 1), Paths { rib: Some((name(2), 2)), ..before }, "only its RIB is another");
    // The daemon of 2 is dead, as 1 has noticed; 3 has not yet.
    states[0].silent = 1 << 0;
    let control = paths(&states, 1);
    assert_eq!((control.rib, next(&states, 1)), (Some((name(4), 1)), vec![(2, 4), (3, 4), (4, 4)]));
    assert_eq!(control.reach[&name(2)], 1 << 3, "frames go on by it");
    states[2].silent = 1 << 0;
    assert_eq!(next(&states, 1), [(3, 4), (4, 4)]);
    states[0].neighbours.pop();
    assert_eq!((paths(&states, 1).rib, next(&states, 1)), (None, vec![]), "only one that control gets to");
}

fn reach(own: u8, states: &[LinkState]) -> Vec<(u8, u64)> {
    let reach = Paths::compute(name(own), states.iter()).reach;
    reach.into_iter().map(|(name, bits)| (name.as_bytes()[0], bits)).collect()
}

fn state(i: u8, bit: u8, neighbours: &[(u8, u32)]) -> LinkState {
    let neighbours = neighbours.iter().map(|(n, cost)| (name(*n), *cost)).collect();
    LinkState {
        switch: name(i),
        run: 1,
        number: 1,
        bit: Some(bit),
        neighbours,
        silent: 0,
        rib: false,
        borders: vec![],
        lifetime: 60,
    }
}

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}
