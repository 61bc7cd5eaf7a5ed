//! `gdp-ctl topology`: the domain's switches and the links between them, as the daemon's switch knows them.

use std::collections::BTreeMap;

use clap::Args;
use petgraph::dot::{Config, Dot};
use petgraph::graph::{NodeIndex, UnGraph};
use serde_json::Value;

use super::Context;
use super::output::{short, table};
use crate::admin::Request;

#[derive(Debug, Args)]
pub struct Options {
    /// Print a graph in the language of Graphviz: … --dot | dot -Tsvg > topology.svg
    #[arg(long, conflicts_with = "json")]
    dot: bool,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let reply = context.client()?.ask_value(&Request::Topology)?;
    context.output.print(reply.clone(), || if options.dot { dot(&reply) } else { describe(&reply) })
}

fn describe(reply: &Value) -> String {
    let or_none = |value: &Value| if value.is_null() { "–".to_owned() } else { value.to_string() };
    let rows: Vec<_> = switches(reply)
        .map(|switch| {
            let near = near(switch).map(|n| format!("{} ({})", short(&n["switch"]), n["cost"]));
            let next = match &switch["next"] {
                Value::Null if switch["switch"] == reply["own"] => "this one".to_owned(),
                Value::Null => "–".to_owned(),
                next => short(next),
            };
            let near = near.collect::<Vec<_>>().join(" ");
            [short(&switch["switch"]), or_none(&switch["bit"]), next, or_none(&switch["cost"]), near]
        })
        .collect();
    table(["switch", "bit", "by way of", "cost of the path", "neighbours (cost)"], &rows)
}

/// An adjacency that only one end states is drawn dashed: no frame goes by it.
fn dot(reply: &Value) -> String {
    let mut graph = UnGraph::<String, Adjacency>::new_undirected();
    let mut nodes = BTreeMap::<String, NodeIndex>::new();
    for switch in switches(reply) {
        let bit = switch["bit"].as_u64().map_or_else(String::new, |bit| format!("\nbit {bit}"));
        let own = if switch["switch"] == reply["own"] { "\nthis one" } else { "" };
        let node = graph.add_node(format!("{}{bit}{own}", short(&switch["switch"])));
        nodes.insert(text(&switch["switch"]), node);
    }
    for switch in switches(reply) {
        let Some(from) = nodes.get(&text(&switch["switch"])).copied() else { continue };
        for neighbour in near(switch) {
            let cost = neighbour["cost"].as_u64().unwrap_or_default();
            let name = text(&neighbour["switch"]);
            let to = *nodes.entry(name).or_insert_with(|| graph.add_node(short(&neighbour["switch"])));
            match graph.find_edge(from, to).and_then(|edge| graph.edge_weight_mut(edge)) {
                Some(known) => *known = Adjacency { cost: known.cost.max(cost), by_both: true },
                None => drop(graph.add_edge(from, to, Adjacency { cost, by_both: false })),
            }
        }
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

fn switches(reply: &Value) -> impl Iterator<Item = &Value> {
    reply["switches"].as_array().into_iter().flatten()
}

fn near(switch: &Value) -> impl Iterator<Item = &Value> {
    switch["neighbours"].as_array().into_iter().flatten()
}

fn text(name: &Value) -> String {
    name.as_str().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gdp_wire::Name;
    use serde_json::json;

    #[test]
    fn a_graph_has_each_adjacency_once_and_says_which_are_one_sided() {
        let name = |i: u8| Name::from_bytes([i; 32]).to_string();
        let switch = |i: u8, near: Value| json!({"switch": name(i), "bit": i, "neighbours": near});
        let reply = json!({"own": name(1), "switches": [
            switch(1, json!([{"switch": name(2), "cost": 7}])),
            switch(2, json!([{"switch": name(1), "cost": 5}, {"switch": name(3), "cost": 9}])),
        ]});
        let dot = dot(&reply);
        assert_eq!(dot.matches(" -- ").count(), 2, "{dot}");
        assert!(dot.contains("label = \"7\"") && dot.contains("this one"), "{dot}");
        let dashed: Vec<_> = dot.lines().filter(|line| line.contains("dashed")).collect();
        assert!(dashed.len() == 1 && dashed[0].contains("label = \"9\""), "{dot}");
        assert!(describe(&reply).contains("this one"));
    }
}
