//! Shortest paths between the switches of a domain: which egress bit a switch has, and which bits lie behind which of
//! its neighbours. Pure: reports in, masks out. Knows nothing of names, links or time; the RIB calls it.

use std::collections::{BTreeMap, VecDeque};

use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;
use petgraph::algo::dijkstra;
use petgraph::graphmap::UnGraphMap;

/// Switches as nodes, by egress bit; edges are adjacencies that both ends reported, with the larger of the two costs.
type Graph = UnGraphMap<u8, u64>;

/// The domain has as many switches as an egress set has bits.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("this RIB already routes between {EGRESS_SET_SIZE} switches, the most one egress set can name")]
pub struct Full;

#[derive(Debug)]
struct Switch {
    bit: u8,
    neighbours: BTreeMap<Name, u32>,
    reach: BTreeMap<Name, u64>,
}

/// The switches of a domain, their adjacencies as they reported them, and the paths that follow.
#[derive(Debug)]
pub struct Topology {
    switches: BTreeMap<Name, Switch>,
    /// Longest free first, so that a bit still on its way in frames is not soon someone else's.
    free_bits: VecDeque<u8>,
}

impl Default for Topology {
    fn default() -> Self {
        Self { switches: BTreeMap::new(), free_bits: (0..EGRESS_SET_SIZE as u8).collect() }
    }
}

impl Topology {
    /// Replaces what `switch` last reported of its neighbours and their costs (0 counts as 1; itself is ignored). A
    /// switch that is new gets an egress bit, which it keeps until it is forgotten: the one it `had`, if that is free. Follow
    /// with [`Self::recompute`].
    pub fn report(
        &mut self,
        switch: Name,
        neighbours: impl IntoIterator<Item = (Name, u32)>,
        had: Option<u8>,
    ) -> Result<(), Full> {
        let neighbours = neighbours.into_iter().filter(|(name, _)| *name != switch).collect();
        match self.switches.get_mut(&switch) {
            Some(known) => known.neighbours = neighbours,
            None => {
                let same = self.free_bits.iter().position(|bit| Some(*bit) == had).unwrap_or(0);
                let bit = self.free_bits.remove(same).ok_or(Full)?;
                self.switches.insert(switch, Switch { bit, neighbours, reach: BTreeMap::new() });
            }
        }
        Ok(())
    }

    /// Removes a switch and frees its bit.
    pub fn forget(&mut self, switch: &Name) {
        if let Some(gone) = self.switches.remove(switch) {
            self.free_bits.push_back(gone.bit);
        }
    }

    /// The switch's egress bit (0 … 63).
    pub fn bit(&self, switch: &Name) -> Option<u8> {
        self.switches.get(switch).map(|s| s.bit)
    }

    /// What a switch last reported.
    pub fn neighbours(&self, switch: &Name) -> impl Iterator<Item = (&Name, u32)> {
        self.switches.get(switch).into_iter().flat_map(|s| s.neighbours.iter().map(|(name, cost)| (name, *cost)))
    }

    /// The egress bits behind each neighbour of `switch`. No bit is behind two of them, and none is the switch's own.
    pub fn reach(&self, switch: &Name) -> Vec<(Name, u64)> {
        self.switches.get(switch).into_iter().flat_map(|s| s.reach.iter().map(|(n, bits)| (*n, *bits))).collect()
    }

    /// Whether there is a path between two switches, as of the last [`Self::recompute`].
    pub fn connected(&self, from: &Name, to: &Name) -> bool {
        from == to && self.switches.contains_key(from)
            || self.bit(to).is_some_and(|bit| {
                self.switches.get(from).is_some_and(|s| s.reach.values().any(|bits| bits & 1 << bit != 0))
            })
    }

    /// Computes all paths anew; returns the switches whose masks changed.
    pub fn recompute(&mut self) -> Vec<Name> {
        let graph = self.graph();
        let names: BTreeMap<u8, Name> = self.switches.iter().map(|(name, s)| (s.bit, *name)).collect();
        let mut reach: BTreeMap<Name, BTreeMap<Name, u64>> = BTreeMap::new();
        for target in graph.nodes() {
            let distance = dijkstra(&graph, target, None, |(_, _, cost)| *cost);
            for from in graph.nodes().filter(|from| *from != target && distance.contains_key(from)) {
                // Every hop is strictly nearer to the target, so paths have no loops whichever tie wins.
                let next = graph
                    .edges(from)
                    .filter_map(|(_, via, cost)| Some((distance.get(&via)?.saturating_add(*cost), names.get(&via)?)))
                    .min();
                if let (Some((_, next)), Some(name)) = (next, names.get(&from)) {
                    *reach.entry(*name).or_default().entry(*next).or_default() |= 1 << target;
                }
            }
        }
        let mut changed = Vec::new();
        for (name, switch) in &mut self.switches {
            let new = reach.remove(name).unwrap_or_default();
            if switch.reach != new {
                switch.reach = new;
                changed.push(*name);
            }
        }
        changed
    }

    fn graph(&self) -> Graph {
        let mut graph = Graph::new();
        for (name, switch) in &self.switches {
            graph.add_node(switch.bit);
            for (neighbour, cost) in &switch.neighbours {
                let Some(other) = self.switches.get(neighbour) else { continue };
                if let Some(back) = other.neighbours.get(name) {
                    graph.add_edge(switch.bit, other.bit, u64::from((*cost).max(*back).max(1)));
                }
            }
        }
        graph
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_leads_through_its_middle() {
        let mut t = Topology::default();
        chain(&mut t, &[1, 2, 3]);
        assert_eq!(t.recompute().len(), 3);
        assert_eq!(t.reach(&name(1)), [(name(2), bits(&t, &[2, 3]))]);
        assert_eq!(t.reach(&name(2)), [(name(1), bits(&t, &[1])), (name(3), bits(&t, &[3]))]);
        assert!(t.connected(&name(1), &name(3)) && t.connected(&name(1), &name(1)));
        assert!(!t.connected(&name(9), &name(9)));
        assert!(t.recompute().is_empty(), "nothing changed");
    }

    #[test]
    fn an_adjacency_counts_only_if_both_ends_report_it() {
        let mut t = Topology::default();
        t.report(name(1), [(name(2), 1)], None).unwrap();
        t.report(name(2), [], None).unwrap();
        t.recompute();
        assert!(!t.connected(&name(1), &name(2)) && t.reach(&name(1)).is_empty());
        t.report(name(2), [(name(1), 1)], None).unwrap();
        assert_eq!(t.recompute(), [name(1), name(2)]);
        assert!(t.connected(&name(1), &name(2)));
    }

    #[test]
    fn the_cheaper_way_wins_and_a_failure_changes_only_the_masks_it_must() {
        // 1 –(1)– 2 –(1)– 3, and 1 –(5)– 3; 4 hangs on 1 by itself.
        let mut t = Topology::default();
        t.report(name(1), [(name(2), 1), (name(3), 5), (name(4), 1)], None).unwrap();
        t.report(name(2), [(name(1), 1), (name(3), 1)], None).unwrap();
        t.report(name(3), [(name(2), 1), (name(1), 2)], None).unwrap();
        t.report(name(4), [(name(1), 1)], None).unwrap();
        t.recompute();
        assert_eq!(t.reach(&name(1)), [(name(2), bits(&t, &[2, 3])), (name(4), bits(&t, &[4]))]);
        t.report(name(3), [(name(1), 2)], None).unwrap();
        assert_eq!(t.recompute(), [name(1), name(2), name(3)], "4 still reaches all through 1");
        assert_eq!(t.reach(&name(2)), [(name(1), bits(&t, &[1, 3, 4]))]);
    }

    #[test]
    fn bits_are_stable_and_run_out_with_an_error() {
        let mut t = Topology::default();
        for i in 0..64 {
            t.report(name(i), [], None).unwrap();
            assert_eq!(t.bit(&name(i)), Some(i as u8));
        }
        assert_eq!(t.report(name(64), [], None), Err(Full));
        t.report(name(5), [(name(6), 1)], None).unwrap();
        assert_eq!(t.bit(&name(5)), Some(5));
        t.forget(&name(7));
        t.report(name(64), [], None).unwrap();
        assert_eq!((t.bit(&name(64)), t.bit(&name(7))), (Some(7), None));
    }

    #[test]
    fn a_switch_gets_the_bit_it_had_if_that_is_free() {
        let mut t = Topology::default();
        for (i, had, gets) in [(1, Some(7), 7), (2, None, 0), (3, Some(7), 1), (4, Some(64), 2), (1, Some(9), 7)] {
            t.report(name(i), [], had).unwrap();
            assert_eq!(t.bit(&name(i)), Some(gets));
        }
    }

    #[test]
    fn on_random_graphs_masks_partition_and_every_bit_arrives_where_it_leads() {
        let mut random = Random(7);
        for round in 0..200 {
            let count = 2 + random.below(23);
            let mut edges: BTreeMap<u64, Vec<(Name, u32)>> = (0..count).map(|i| (i, Vec::new())).collect();
            for _ in 0..random.below(3 * count) {
                let (a, b) = (random.below(count), random.below(count));
                for (from, to) in [(a, b), (b, a)] {
                    // One report in ten is missing, so that some adjacencies are known to one end only.
                    if random.below(10) != 0 {
                        edges.get_mut(&from).unwrap().push((name(to), random.below(9) as u32));
                    }
                }
            }
            let mut t = Topology::default();
            edges.iter().for_each(|(i, n)| t.report(name(*i), n.clone(), None).unwrap());
            t.recompute();
            for from in 0..count {
                let mut seen = 1u64 << t.bit(&name(from)).unwrap();
                for (_, bits) in t.reach(&name(from)) {
                    assert_eq!(seen & bits, 0, "round {round}: masks of {from} overlap");
                    seen |= bits;
                }
                for to in 0..count {
                    assert_eq!(walk(&t, name(from), name(to), count), t.connected(&name(from), &name(to)));
                    assert_eq!(t.connected(&name(from), &name(to)), t.connected(&name(to), &name(from)));
                }
            }
        }
    }

    /// Follows the bit of `to` hop by hop; whether it arrives. Panics on a loop.
    fn walk(t: &Topology, from: Name, to: Name, longest: u64) -> bool {
        let bit = 1 << t.bit(&to).unwrap();
        let mut at = from;
        for _ in 0..=longest {
            if at == to {
                return true;
            }
            match t.reach(&at).into_iter().find(|(_, bits)| bits & bit != 0) {
                Some((next, _)) => at = next,
                None => return false,
            }
        }
        panic!("a loop");
    }

    fn chain(t: &mut Topology, switches: &[u64]) {
        for (i, switch) in switches.iter().enumerate() {
            let near = [i.checked_sub(1), Some(i + 1)];
            let near = near.iter().flatten().filter_map(|j| switches.get(*j)).map(|n| (name(*n), 1));
            t.report(name(*switch), near.collect::<Vec<_>>(), None).unwrap();
        }
    }

    fn bits(t: &Topology, switches: &[u64]) -> u64 {
        switches.iter().map(|s| 1 << t.bit(&name(*s)).unwrap()).sum()
    }

    fn name(i: u64) -> Name {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&i.to_le_bytes());
        Name::from_bytes(bytes)
    }

    struct Random(u64);

    impl Random {
        fn below(&mut self, bound: u64) -> u64 {
            self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (self.0 >> 33) % bound
        }
    }
}
