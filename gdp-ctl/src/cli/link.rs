//! `gdp-ctl link list`: the daemon's live links.

use clap::Subcommand;
use serde_json::Value;

use super::output::{short, table};
use crate::cli::context::Context;
use gdp_proto::admin::Request;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Print every live link: who is at its other end, how it is reached, and whether the kernel
    /// sends on it.
    List,
}

pub fn run(command: &Command, context: &Context) -> anyhow::Result<()> {
    let Command::List = command;
    let reply = context.client()?.ask_value(&Request::Links)?;
    context.output.print(reply.clone(), || describe(&reply))
}

fn describe(reply: &Value) -> Vec<String> {
    let rows: Vec<_> = reply["links"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|link| {
            let text = |key: &str| link[key].as_str().unwrap_or_default().to_owned();
            let id = format!("{:#x}", link["id"].as_u64().unwrap_or_default());
            let age = duration(link["age_s"].as_u64().unwrap_or_default());
            let (mtu, rtt) = (link["mtu"].to_string(), format!("{} µs", link["rtt_us"]));
            let (taken, dropped) = arrivals(&link["arrivals"]);
            let role = match text("standing").as_str() {
                "" | "stranger" | "border" => text("role"),
                standing => format!("{} ({standing})", text("role")),
            };
            let via = if link["carrier"] == false { format!("{} (no carrier)", text("via")) } else { text("via") };
            let place = [role, via, text("address")];
            let [role, via, address] = place;
            let cost = link["cost"].as_u64().map_or_else(|| "–".to_owned(), |cost| cost.to_string());
            [
                id,
                short(&link["peer"]),
                role,
                via,
                address,
                mtu,
                rtt,
                cost,
                age,
                text("plane"),
                link["sent"].to_string(),
                taken,
                dropped,
            ]
        })
        .collect();
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

/// Frames that came in on a link, and how many of them were dropped, by reason.
fn arrivals(counts: &Value) -> (String, String) {
    let counts = || counts.as_object().into_iter().flatten();
    let taken: u64 = counts().filter_map(|(_, frames)| frames.as_u64()).sum();
    let dropped: Vec<_> =
        counts().filter_map(|(name, n)| Some(format!("{} {n}", name.strip_prefix("drop_")?))).collect();
    (taken.to_string(), dropped.join(", "))
}

/// In the two largest units, as `3h 20m`.
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
