//! `gdp-ctl peer list`: neighbours with which the daemon's switch has, or should have, links.

use super::output::{or_dash, table};
use crate::cli::context::Context;
use clap::Subcommand;
use gdp_proto::admin::Request;
use gdp_proto::admin::links::PeersReply;
use gdp_proto::admin::words::PeerLink;
use gdp_util::date::rounded;
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// List the neighbouring switches and domains: relationship, rights, expiry, link state, and
    /// the reason if the link is down.
    List,
}

pub fn run(command: &Command, context: &Context) -> anyhow::Result<()> {
    let Command::List = command;
    let reply = context.client()?.ask(&Request::Peers)?;
    context.output.print(&reply, || describe(&reply))
}

fn describe(reply: &PeersReply) -> Vec<String> {
    let now = unix_seconds();
    let rows = reply.peers.iter().map(|peer| {
        let domain = match peer.domain {
            domain if domain.is_some() && domain == reply.domain => "own".to_owned(),
            domain => or_dash(domain.map(|domain| format!("{domain:#}"))),
        };
        let why = match (&peer.reason, peer.reason_age_s) {
            (Some(reason), Some(age)) if peer.link != PeerLink::Up => format!("{reason} ({age} s ago)"),
            _ => String::new(),
        };
        [
            format!("{:#}", peer.peer),
            domain,
            or_dash(peer.relationship),
            or_dash(peer.rights_granted.as_ref()),
            or_dash(peer.rights_received.as_ref()),
            or_dash(peer.until.map(|until| rounded(until.saturating_sub(now)))),
            peer.link.to_string(),
            or_dash(peer.via.as_ref()),
            why,
        ]
    });
    let rows: Vec<_> = rows.collect();
    table(
        ["peer", "domain", "relationship", "may do here", "lets us", "ends in", "link", "via", "why there is no link"],
        &rows,
    )
}

#[cfg(test)]
#[path = "../../tests/unit/cli/peer.rs"]
mod tests;
