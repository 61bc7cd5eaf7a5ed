//! Shortest paths from one switch to all others. The result is the next hop to each switch, and the
//! mask of egress bits behind each neighbour. Pure: statements in, paths out.

use std::collections::{BTreeMap, BTreeSet};

use gdp_core::cert::LinkState;
use gdp_wire::Name;
use petgraph::algo::dijkstra;
use petgraph::graphmap::UnGraphMap;

/// Graph of switches and the adjacencies that both ends state, with the larger of the two costs.
type SwitchGraph = UnGraphMap<Name, u64>;

/// Paths of one switch, computed from the statements of all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Paths {
    /// Egress bits by neighbour. No bit is behind two neighbours, and none is the switch's own.
    pub reach: BTreeMap<Name, u64>,
    /// Reachable switches including this one, with the cost of the path.
    pub costs: BTreeMap<Name, u64>,
    /// Owner of each egress bit. If two switches state the same bit, the one that has run longest
    /// owns it.
    pub bits: BTreeMap<u8, Name>,
    /// Next hop of control messages to each switch. Neither the destination nor any switch on the
    /// way has a daemon that does not answer.
    pub next: BTreeMap<Name, Name>,
    /// Nearest switch with the domain's RIB that control messages reach, and its run. The lower
    /// name wins a tie; it may be this switch. A restarted RIB counts as another.
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

    /// Returns whether there is a path to a switch.
    pub fn reaches(&self, switch: &Name) -> bool {
        self.costs.contains_key(switch)
    }

    /// Returns the egress bit that a switch owns.
    pub fn bit(&self, switch: &Name) -> Option<u8> {
        self.bits.iter().find(|(_, of)| *of == switch).map(|(bit, _)| *bit)
    }
}

/// Returns the next hop to each of the reachable switches.
fn next_hops(graph: &SwitchGraph, own: Name, reached: &BTreeMap<Name, u64>) -> BTreeMap<Name, Name> {
    let onward: Vec<_> = graph.edges(own).map(|(_, via, cost)| (via, *cost, costs_from(graph, via))).collect();
    let hop = |switch: &Name| {
        // Every hop is strictly nearer to the switch, so paths have no loops whichever neighbour
        // wins a tie.
        let ways = onward.iter().filter_map(|(via, cost, costs)| Some((costs.get(switch)? + cost, *via)));
        Some((*switch, ways.min()?.1))
    };
    reached.keys().filter(|switch| **switch != own).filter_map(hop).collect()
}

fn costs_from(graph: &SwitchGraph, switch: Name) -> BTreeMap<Name, u64> {
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

/// Builds the graph of adjacencies. `counts` states whether a switch's adjacency to the neighbour
/// with this index is used.
fn graph(states: &BTreeMap<Name, &LinkState>, counts: impl Fn(&LinkState, usize) -> bool) -> SwitchGraph {
    let cost_to = |state: &LinkState, neighbour: &Name| {
        let at = state.neighbours.binary_search_by(|(name, _)| name.cmp(neighbour)).ok()?;
        counts(state, at).then(|| state.neighbours[at].1)
    };
    let mut graph = SwitchGraph::new();
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
#[path = "../../tests/unit/topology/paths.rs"]
mod tests;
