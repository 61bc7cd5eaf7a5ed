//! The topology as a Graphviz graph.

use std::collections::BTreeMap;

use gdp_proto::admin::topology::TopologyReply;
use gdp_wire::Name;
use petgraph::dot::{Config, Dot};
use petgraph::graph::{NodeIndex, UnGraph};

use super::links::{Edge, edges};

/// Returns the graph. An adjacency that only one end states is dashed, because it carries no
/// frames.
///
/// `names` has the last lines of each switch's label.
pub fn dot(reply: &TopologyReply, names: &BTreeMap<Name, Vec<String>>) -> String {
    let mut graph = UnGraph::<String, Adjacency>::new_undirected();
    let mut nodes = BTreeMap::<Name, NodeIndex>::new();
    for switch in &reply.switches {
        let bit = switch.bit.map_or_else(String::new, |bit| format!("\nbit {bit}"));
        let rib = if switch.rib { " (RIB)" } else { "" };
        let own = if switch.switch == reply.own { "\nthis one" } else { "" };
        let names = names.get(&switch.switch).into_iter().flatten().map(|line| format!("\n{line}"));
        let names = names.collect::<String>();
        nodes.insert(switch.switch, graph.add_node(format!("{:#}{bit}{rib}{own}{names}", switch.switch)));
    }
    for Edge { ends, cost, by_both, domain } in edges(reply) {
        let domain = domain.map_or_else(String::new, |domain| format!("\ndomain {domain:#}"));
        let [from, to] =
            ends.map(|name| *nodes.entry(name).or_insert_with(|| graph.add_node(format!("{name:#}{domain}"))));
        graph.add_edge(from, to, Adjacency { cost, by_both });
    }
    let drawn = graph.map(|_, label| label.clone(), |_, adjacency| adjacency.cost);
    let style = |_, edge: petgraph::graph::EdgeReference<'_, u32>| {
        use petgraph::visit::EdgeRef;
        let by_both = graph.edge_weight(edge.id()).is_some_and(|adjacency| adjacency.by_both);
        if by_both { String::new() } else { "style = dashed".into() }
    };
    let dot = Dot::with_attr_getters(&drawn, &[] as &[Config], &style, &|_, _| String::new());
    dot.to_string().trim_end().to_owned()
}

struct Adjacency {
    cost: u32,
    by_both: bool,
}
