//! `gdp-ctl monitor`: what happens at the daemon's switch, as it happens.

use serde_json::Value;

use super::output::short;
use crate::cli::context::Context;

pub fn run(context: &Context) -> anyhow::Result<()> {
    for event in context.client()?.monitor()? {
        let event = event?;
        context.output.print(event.clone(), || [describe(&event)])?;
    }
    Ok(())
}

fn describe(event: &Value) -> String {
    let at = event["at"].as_u64().unwrap_or_default();
    let (seconds, millis) = (at / 1_000_000_000, at / 1_000_000 % 1000);
    let clock = format!("{:02}:{:02}:{:02}.{millis:03}Z", seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    let kind = event["event"].as_str().unwrap_or_default().replace('_', " ");
    let text = |key: &str| event[key].as_str().unwrap_or_default().to_owned();
    let name = |key: &str| short(&event[key]);
    let what = match event["event"].as_str().unwrap_or_default() {
        "link_up" => {
            format!("{} ({}, {}) {} {}", name("peer"), text("role"), text("standing"), text("via"), text("address"))
        }
        "link_down" => format!("{}: {}", name("peer"), text("reason")),
        "link_refused" => format!("{} {}: {}", name("peer"), text("via"), text("reason")),
        "attached" | "detached" => name("entity"),
        "routes" => format!("{} changed, generation {}", event["changes"], event["generation"]),
        "topology" => format!("{} of {} switches reached", event["reached"], event["switches"]),
        "rib" => format!("{} names, {} switches", event["names"], event["switches"]),
        "missed" => format!("{} events: this program reads too slowly", event["events"]),
        _ => event.to_string(),
    };
    format!("{clock}  {kind:12}  {what}")
}

#[cfg(test)]
#[path = "../../tests/unit/cli/monitor.rs"]
mod tests;
