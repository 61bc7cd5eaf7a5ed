//! The topology in the language of Graphviz.

use std::collections::BTreeMap;

use petgraph::dot::{Config, Dot};
use petgraph::graph::{NodeIndex, UnGraph};
use serde_json::Value;

use super::super::output::short;
use super::{Link, links, switches, text};

/// An adjacency that only one end states is drawn dashed: no frame goes by it.
pub fn dot(reply: &Value) -> String {
    let mut graph = UnGraph::<String, Adjacency>::new_undirected();
    let mut nodes = BTreeMap::<String, NodeIndex>::new();
    for switch in switches(reply) {
        let bit = switch["bit"].as_u64().map_or_else(String::new, |bit| format!("\nbit {bit}"));
        let own = if switch["switch"] == reply["own"] { "\nthis one" } else { "" };
        let node = graph.add_node(format!("{}{bit}{own}", short(&switch["switch"])));
        nodes.insert(text(&switch["switch"]), node);
    }
    for Link { ends, cost, by_both, domain } in links(reply) {
        let domain = domain.map_or_else(String::new, |domain| format!("\ndomain {}", short(&domain.into())));
        let [from, to] = ends.map(|name| {
            let label = || format!("{}{domain}", short(&name.as_str().into()));
            *nodes.entry(name.clone()).or_insert_with(|| graph.add_node(label()))
        });
        graph.add_edge(from, to, Adjacency { cost, by_both });
    }
    let drawn = graph.map(|_, label| label.clone(), |_, adjacency| adjacency.cost);
    let style = |_, edge: petgraph::graph::EdgeReference<'_, u64>| {
        use petgraph::visit::EdgeRef;
        let by_both = graph.edge_weight(edge.id()).is_some_and(|adjacency| adjacency.by_both);
        if by_both { String::new() } else { "style = dashed".into() }
    };
    let dot = Dot::with_attr_getters(&drawn, &[] as &[Config], &style, &|_, _| String::new());
    dot.to_string().trim_end().to_owned()
}

struct Adjacency {
    cost: u64,
    by_both: bool,
}
