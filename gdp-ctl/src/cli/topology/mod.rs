//! `gdp-ctl topology`: the domain's switches and the links between them, as the daemon's switch
//! knows them.

mod dot;
mod links;

use std::collections::BTreeMap;

use clap::Args;
use gdp_proto::control::Record;
use serde_json::Value;

use self::links::{near, switches};
use super::output::{lines_of, short, table};
use crate::cli::context::Context;
use crate::client::Client;
use gdp_proto::admin::Request;

/// Records that are looked through for the names at each switch. A label has at most 8 names.
const MOST_RECORDS: usize = 10_000;

#[derive(Debug, Args)]
pub struct Options {
    /// Print a graph in the language of Graphviz: … --dot | dot -Tsvg > topology.svg
    #[arg(long, conflicts_with = "json")]
    dot: bool,
    /// With --dot: also what entities at each switch publish and read. Asks the RIB, which must be
    /// this daemon.
    #[arg(long, requires = "dot")]
    names: bool,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut client = context.client()?;
    let reply = client.ask_value(&Request::Topology)?;
    let names = if options.names { names(&mut client)? } else { BTreeMap::new() };
    context
        .output
        .print(reply.clone(), || if options.dot { lines_of(&dot::dot(&reply, &names)) } else { describe(&reply) })
}

/// What the RIB's records say of each switch: names, and the roles of entities for them.
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

fn describe(reply: &Value) -> Vec<String> {
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

#[cfg(test)]
#[path = "../../../tests/unit/cli/topology.rs"]
mod tests;
