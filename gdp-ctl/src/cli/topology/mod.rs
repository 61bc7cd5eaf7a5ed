//! `gdp-ctl topology`: the domain's switches and the links between them, as the daemon's switch knows them.

mod dot;
mod layout;
mod svg;

use std::collections::BTreeMap;

use clap::Args;
use gdp_proto::control::Record;
use serde_json::Value;

use super::Context;
use super::output::{short, table};
use crate::client::Client;
use gdp_proto::admin::Request;

/// Records that are looked through for the names at each switch.
const MOST_RECORDS: usize = 10_000;

#[derive(Debug, Args)]
pub struct Options {
    /// Print a graph in the language of Graphviz: … --dot | dot -Tsvg > topology.svg
    #[arg(long, conflicts_with = "json")]
    dot: bool,
    /// Draw it: … --svg > topology.svg. Other domains are beside the own one; a link that only one end states is dashed.
    #[arg(long, conflicts_with_all = ["json", "dot"])]
    svg: bool,
    /// With --svg: also what entities at each switch publish and read. Asks the RIB, which must be this daemon.
    #[arg(long, requires = "svg")]
    names: bool,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut client = context.client()?;
    let reply = client.ask_value(&Request::Topology)?;
    let names = if options.names { names(&mut client)? } else { BTreeMap::new() };
    context.output.print(reply.clone(), || {
        if options.dot {
            dot::dot(&reply)
        } else if options.svg {
            svg::svg(&reply, &names)
        } else {
            describe(&reply)
        }
    })
}

/// What the RIB's records say of each switch: names, and what entities are to them.
fn names(client: &mut Client) -> anyhow::Result<BTreeMap<String, Vec<String>>> {
    let (mut names, mut after, mut seen) = (BTreeMap::<String, Vec<String>>::new(), None, 0);
    loop {
        let page = client.ask_value(&Request::Rib { after })?;
        let records: Vec<Record> = serde_json::from_value(page["records"].clone())?;
        seen += records.len();
        for record in &records {
            let line = format!("{:#} {}", record.name, record.role()?);
            names.entry(record.switch.to_string()).or_default().push(line);
        }
        after = records.last().map(Record::place).transpose()?;
        if page["more"] != true || after.is_none() || seen >= MOST_RECORDS {
            return Ok(names);
        }
    }
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

/// A link between two switches, of whom one at least is of the own domain.
struct Link {
    /// Names; the second one is of `domain`, if that is another.
    ends: [String; 2],
    cost: u64,
    /// Only then frames go by it. Of a link into another domain, the other end is not heard.
    by_both: bool,
    domain: Option<String>,
}

/// Each adjacency once, with the larger of the costs.
fn links(reply: &Value) -> Vec<Link> {
    let (mut home, mut abroad) = (BTreeMap::<[String; 2], Link>::new(), Vec::new());
    for switch in switches(reply) {
        let own = text(&switch["switch"]);
        for neighbour in near(switch) {
            let (other, cost) = (text(&neighbour["switch"]), neighbour["cost"].as_u64().unwrap_or_default());
            let mut ends = [own.clone(), other];
            ends.sort();
            match home.get_mut(&ends) {
                Some(known) => (known.cost, known.by_both) = (known.cost.max(cost), true),
                None => drop(home.insert(ends.clone(), Link { ends, cost, by_both: false, domain: None })),
            }
        }
        for border in switch["borders"].as_array().into_iter().flatten() {
            let (ends, cost) = ([own.clone(), text(&border["switch"])], border["cost"].as_u64().unwrap_or_default());
            abroad.push(Link { ends, cost, by_both: true, domain: Some(text(&border["domain"])) });
        }
    }
    home.into_values().chain(abroad).collect()
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
#[path = "../../../tests/unit/cli/topology.rs"]
mod tests;
