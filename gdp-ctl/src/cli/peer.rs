//! `gdp-ctl peer list`: whom the daemon's switch has, or should have, links with.

use clap::Subcommand;
use serde_json::Value;

use super::output::{short, table};
use crate::cli::context::Context;
use gdp_proto::admin::Request;
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Print neighbouring switches and domains: what each is, what it may do and until when,
    /// whether its link is up, and why not.
    List,
}

pub fn run(command: &Command, context: &Context) -> anyhow::Result<()> {
    let Command::List = command;
    let reply = context.client()?.ask_value(&Request::Peers)?;
    context.output.print(reply.clone(), || describe(&reply))
}

fn describe(reply: &Value) -> Vec<String> {
    let now = unix_seconds();
    let rows: Vec<_> = reply["peers"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|peer| {
            let text = |key: &str| peer[key].as_str().unwrap_or("–").to_owned();
            let domain = match &peer["domain"] {
                Value::Null => "–".to_owned(),
                domain if *domain == reply["domain"] => "own".to_owned(),
                domain => short(domain),
            };
            let until = match peer["until"].as_u64() {
                Some(until) => format!("{} s", until.saturating_sub(now)),
                None => "–".to_owned(),
            };
            let why = match (peer["link"] == "up", peer["reason"].as_str()) {
                (false, Some(reason)) => format!("{reason} ({} s ago)", peer["reason_age_s"]),
                _ => String::new(),
            };
            [
                short(&peer["peer"]),
                domain,
                text("standing"),
                text("rights_given"),
                text("rights_held"),
                until,
                text("link"),
                text("via"),
                why,
            ]
        })
        .collect();
    table(
        ["peer", "domain", "standing", "may do here", "lets us", "ends in", "link", "via", "why there is no link"],
        &rows,
    )
}

#[cfg(test)]
#[path = "../../tests/unit/cli/peer.rs"]
mod tests;
