//! `gdp-ctl peer list`: whom the daemon's switch has, or should have, links with.

use clap::Subcommand;
use serde_json::Value;

use super::Context;
use super::output::{short, table};
use gdp_proto::admin::Request;
use gdp_util::unix_time::unix_seconds;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Print neighbouring switches and domains: what each is, what it may do and until when, whether its link is up, and why not.
    List,
}

pub fn run(command: &Command, context: &Context) -> anyhow::Result<()> {
    let Command::List = command;
    let reply = context.client()?.ask_value(&Request::Peers)?;
    context.output.print(reply.clone(), || describe(&reply))
}

fn describe(reply: &Value) -> String {
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
mod tests {
    use super::*;
    use gdp_wire::Name;
    use serde_json::json;

    #[test]
    fn a_peer_without_a_link_has_a_reason() {
        let (home, away, peer) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]), Name::from_bytes([3; 32]));
        let up = json!({"peer": peer, "domain": away, "standing": "border", "rights_given": "peering",
            "rights_held": "peering,transit", "until": unix_seconds() + 1000, "link": "up", "via": "e0", "reason": null});
        let down = json!({"peer": peer, "domain": null, "standing": null, "link": "down", "via": "e1",
            "reason": "nobody answers", "reason_age_s": 7});
        let text = describe(&json!({"domain": home, "peers": [up, down]}));
        let lines: Vec<_> = text.lines().collect();
        assert!(lines[1].contains(&format!("{away:#}")) && lines[1].contains("peering,transit"), "{text}");
        assert!(lines[2].ends_with("nobody answers (7 s ago)"), "{text}");
    }
}
