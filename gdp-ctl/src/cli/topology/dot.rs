//! The topology in the language of Graphviz.

use std::collections::BTreeMap;

use petgraph::dot::{Config, Dot};
use petgraph::graph::{NodeIndex, UnGraph};
use serde_json::Value;

use super::super::output::short;
use super::links::{Link, links, switches, text};

/// An adjacency that only one end states is drawn dashed: no frame goes by it.
///
/// `names` has the lines that each switch's label ends with.
pub fn dot(reply: &Value, names: &BTreeMap<String, Vec<String>>) -> String {
    let mut graph = UnGraph::<String, Adjacency>::new_undirected();
    let mut nodes = BTreeMap::<String, NodeIndex>::new();
    for switch in switches(reply) {
        let bit = switch["bit"].as_u64().map_or_else(String::new, |bit| format!("\nbit {bit}"));
        let rib = if switch["rib"] == true { " (RIB)" } else { "" };
        let own = if switch["switch"] == reply["own"] { "\nthis one" } else { "" };
        let names = names.get(&text(&switch["switch"])).into_iter().flatten().map(|line| format!("\n{line}"));
        let names = names.collect::<String>();
        let node = graph.add_node(format!("{}{bit}{rib}{own}{names}", short(&switch["switch"])));
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
