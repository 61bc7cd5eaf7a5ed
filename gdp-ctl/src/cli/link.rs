//! `gdp-ctl link list`: the daemon's live links.

use super::output::{or_dash, table};
use crate::cli::context::Context;
use clap::Subcommand;
use gdp_proto::admin::Request;
use gdp_proto::admin::links::{Counts, LinkStatus, LinksReply};
use gdp_proto::admin::words::PeerRelationship;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// List the live links: peer, transport and address of each, and whether the kernel sends on
    /// it.
    List,
}

pub fn run(command: &Command, context: &Context) -> anyhow::Result<()> {
    let Command::List = command;
    let reply = context.client()?.ask(&Request::Links)?;
    context.output.print(&reply, || describe(&reply))
}

fn describe(reply: &LinksReply) -> Vec<String> {
    let rows: Vec<_> = reply.links.iter().map(row).collect();
    table(
        [
            "id",
            "link to",
            "role",
            "via",
            "address",
            "MTU",
            "RTT",
            "cost",
            "age",
            "plane",
            "frames out",
            "frames in",
            "of these dropped",
        ],
        &rows,
    )
}

fn row(link: &LinkStatus) -> [String; 13] {
    let (taken, dropped) = link.arrivals.as_ref().map(arrivals).unwrap_or_default();
    let role = match link.relationship {
        PeerRelationship::Stranger | PeerRelationship::Border => link.role.to_string(),
        relationship => format!("{} ({relationship})", link.role),
    };
    [
        format!("{:#x}", link.id),
        format!("{:#}", link.peer),
        role,
        match (link.carrier, link.answers) {
            (false, _) => format!("{} (no carrier)", link.via),
            (true, false) => format!("{} (no answer)", link.via),
            (true, true) => link.via.clone(),
        },
        link.address.clone(),
        link.mtu.to_string(),
        format!("{} µs", link.rtt_us),
        or_dash(link.cost),
        duration(link.age_s),
        link.plane.clone(),
        link.sent.to_string(),
        taken,
        dropped,
    ]
}

/// Returns the number of frames that arrived on a link, and the number of dropped frames for each
/// drop reason.
fn arrivals(counts: &Counts) -> (String, String) {
    let dropped = counts.iter().filter_map(|(name, n)| Some(format!("{} {n}", name.strip_prefix("drop_")?)));
    (counts.values().sum::<u64>().to_string(), dropped.collect::<Vec<_>>().join(", "))
}

/// Returns a duration in its two largest units, such as `3h 20m`.
fn duration(seconds: u64) -> String {
    let units = [(86400, "d"), (3600, "h"), (60, "m"), (1, "s")];
    let first = units.iter().position(|(size, _)| seconds >= *size).unwrap_or(3);
    let parts = units[first..].iter().take(2).scan(seconds, |left, (size, unit)| {
        let count = *left / size;
        *left %= size;
        Some(format!("{count}{unit}"))
    });
    parts.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
#[path = "../../tests/unit/cli/link.rs"]
mod tests;
