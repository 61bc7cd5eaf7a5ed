//! `gdp-ctl topology`: the domain's switches and the links between them, in the view of the
//! daemon's switch.

mod dot;
mod links;

use std::collections::BTreeMap;

use clap::Args;
use gdp_proto::control::Record;
use gdp_wire::Name;

pub use links::{Edge, edges};

use super::output::{lines_of, or_dash, table};
use crate::cli::context::Context;
use crate::client::Client;
use gdp_proto::admin::Request;
use gdp_proto::admin::tables::RibReply;
use gdp_proto::admin::topology::{Adjacency, TopologyReply};

/// Maximum number of records that are searched for the names at each switch. A label has at most 8
/// names.
const MOST_RECORDS: usize = 10_000;

#[derive(Debug, Args)]
pub struct Options {
    /// Print a graph for Graphviz: … --dot | dot -Tsvg > topology.svg
    #[arg(long, conflicts_with = "json")]
    dot: bool,
    /// With --dot: also print the names that entities at each switch publish and read. The RIB must
    /// be in this daemon.
    #[arg(long, requires = "dot")]
    names: bool,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut client = context.client()?;
    let reply = client.ask(&Request::Topology)?;
    let names = if options.names { names(&mut client)? } else { BTreeMap::new() };
    context.output.print(&reply, || if options.dot { lines_of(&dot::dot(&reply, &names)) } else { describe(&reply) })
}

/// Returns the names at each switch from the RIB's records, with the roles of entities.
fn names(client: &mut Client) -> anyhow::Result<BTreeMap<Name, Vec<String>>> {
    let (mut names, mut after, mut seen) = (BTreeMap::<Name, Vec<String>>::new(), None, 0);
    loop {
        let RibReply { records, more, .. } = client.ask(&Request::Rib { after })?;
        seen += records.len();
        for record in &records {
            let line = format!("{:#} {}", record.name, record.role()?);
            names.entry(record.switch).or_default().push(line);
        }
        after = records.last().map(Record::key).transpose()?;
        if !more || after.is_none() || seen >= MOST_RECORDS {
            return Ok(names);
        }
    }
}

fn describe(reply: &TopologyReply) -> Vec<String> {
    let rows = reply.switches.iter().map(|switch| {
        let next = match switch.next {
            None if switch.switch == reply.own => "this one".to_owned(),
            next => or_dash(next.map(|next| format!("{next:#}"))),
        };
        let near = neighbours(&switch.neighbours);
        [format!("{:#}", switch.switch), or_dash(switch.bit), next, or_dash(switch.cost), near]
    });
    table(["switch", "bit", "by way of", "cost of the path", "neighbours (cost)"], &rows.collect::<Vec<_>>())
}

/// Returns the neighbours with their costs.
pub fn neighbours(adjacencies: &[Adjacency]) -> String {
    let near = adjacencies.iter().map(|n| format!("{:#} ({})", n.switch, n.cost));
    near.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/topology.rs"]
mod tests;
