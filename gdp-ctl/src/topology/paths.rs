//! Shortest paths from one switch to all others: the next hop toward each, and as masks which egress bits lie behind which of its
//! neighbours. Pure: statements in, paths out.

use std::collections::{BTreeMap, BTreeSet};

use gdp::cert::LinkState;
use gdp_wire::Name;
use petgraph::algo::dijkstra;
use petgraph::graphmap::UnGraphMap;

/// Switches, and the adjacencies that both ends state, with the larger of the two costs.
type Graph = UnGraphMap<Name, u64>;

/// What follows for one switch from what all state.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Paths {
    /// Egress bits by neighbour. No bit is behind two of them, and none is the switch's own.
    pub reach: BTreeMap<Name, u64>,
    /// The switches there is a path to, this one among them, and what the path costs.
    pub costs: BTreeMap<Name, u64>,
    /// Whose each egress bit is: if two switches state the same, that of the one that has run longest counts.
    pub bits: BTreeMap<u8, Name>,
    /// The neighbour by which control gets to each other switch: no switch whose daemon does not answer is on the way, or its end.
    pub next: BTreeMap<Name, Name>,
    /// The nearest switch with the domain's RIB that control gets to, the lower name of two; this one, if it is here. And which run
    /// of that switch: a RIB that has started anew is another.
    pub rib: Option<(Name, u64)>,
}

impl Paths {
    pub fn compute<'a>(own: Name, states: impl Iterator<Item = &'a LinkState>) -> Self {
        let states: BTreeMap<Name, &LinkState> = states.map(|state| (state.switch, state)).collect();
        let of_frames = graph(&states, |_, _| true);
        let costs = costs_from(&of_frames, own);
        let bits = bits(states.values().filter(|state| costs.contains_key(&state.switch)));
        let onward = next_hops(&of_frames, own, &costs);
        let mut reach = BTreeMap::<Name, u64>::new();
        for (bit, switch) in &bits {
            if let Some(via) = onward.get(switch) {
                *reach.entry(*via).or_default() |= 1 << bit;
            }
        }
        let of_control = graph(&states, |state, index| state.silent & 1 << index == 0);
        let to_daemons = costs_from(&of_control, own);
        let next = next_hops(&of_control, own, &to_daemons);
        let ribs = states.values().filter(|state| state.rib);
        let rib = ribs.filter_map(|state| Some((to_daemons.get(&state.switch)?, state.switch, state.run))).min();
        Self { reach, rib: rib.map(|(_, switch, run)| (switch, run)), costs, bits, next }
    }

    /// Whether there is a path to a switch.
    pub fn reaches(&self, switch: &Name) -> bool {
        self.costs.contains_key(switch)
    }

    /// The egress bit that counts for a switch.
    pub fn bit(&self, switch: &Name) -> Option<u8> {
        self.bits.iter().find(|(_, of)| *of == switch).map(|(bit, _)| *bit)
    }
}

/// The neighbour that leads to each of the switches that are reached.
fn next_hops(graph: &Graph, own: Name, reached: &BTreeMap<Name, u64>) -> BTreeMap<Name, Name> {
    let onward: Vec<_> = graph.edges(own).map(|(_, via, cost)| (via, *cost, costs_from(graph, via))).collect();
    let hop = |switch: &Name| {
        // Every hop is strictly nearer to the switch, so paths have no loops whichever tie wins.
        let ways = onward.iter().filter_map(|(via, cost, costs)| Some((costs.get(switch)? + cost, *via)));
        Some((*switch, ways.min()?.1))
    };
    reached.keys().filter(|switch| **switch != own).filter_map(hop).collect()
}

fn costs_from(graph: &Graph, switch: Name) -> BTreeMap<Name, u64> {
    dijkstra(graph, switch, None, |(_, _, cost)| *cost).into_iter().collect()
}

fn bits<'a>(states: impl Iterator<Item = &'a &'a LinkState>) -> BTreeMap<u8, Name> {
    let claims: BTreeSet<(u8, u64, Name)> =
        states.filter_map(|state| Some((state.bit?, state.run, state.switch))).collect();
    let mut bits = BTreeMap::new();
    for (bit, _, switch) in claims {
        bits.entry(bit).or_insert(switch);
    }
    bits
}

/// `counts`: whether what a switch states of the neighbour with this index does.
fn graph(states: &BTreeMap<Name, &LinkState>, counts: impl Fn(&LinkState, usize) -> bool) -> Graph {
    let cost_to = |state: &LinkState, neighbour: &Name| {
        let at = state.neighbours.binary_search_by(|(name, _)| name.cmp(neighbour)).ok()?;
        counts(state, at).then(|| state.neighbours[at].1)
    };
    let mut graph = Graph::new();
    for (name, state) in states {
        graph.add_node(*name);
        for (neighbour, _) in &state.neighbours {
            let there = cost_to(state, neighbour);
            let back = states.get(neighbour).and_then(|other| cost_to(other, name));
            if let (Some(there), Some(back)) = (there, back) {
                graph.add_edge(*name, *neighbour, u64::from(there.max(back)));
            }
        }
    }
    graph
}

#[cfg(test)]
mod tests {
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
}
