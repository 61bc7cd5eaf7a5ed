//! `gdp-ctl status`: the daemon as it sees itself.

use serde_json::Value;

use super::output::{short, table};
use crate::cli::context::Context;
use gdp_proto::admin::Request;

pub fn run(context: &Context) -> anyhow::Result<()> {
    let status = context.client()?.ask_value(&Request::Status)?;
    context.output.print(status.clone(), || describe(&status))
}

fn describe(status: &Value) -> Vec<String> {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let items = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let mut lines = vec![
        format!("switch      {}", text(&status["name"])),
        format!("data plane  {}: {}", text(&status["data_plane"]), text(&status["data_plane_reason"])),
    ];
    let control = &status["control"];
    lines.push(match (&status["rib"], control["reason"].as_str()) {
        (Value::Object(rib), _) => format!("RIB         here: {} names, {} switches", rib["names"], rib["switches"]),
        (_, None) => format!("RIB         at {}, through {}", short(&control["rib"]), short(&control["next"])),
        (_, Some(reason)) => format!("RIB         not reached: {reason}"),
    });
    if let Some(fenced) = control["fenced"].as_u64().filter(|fenced| *fenced > 0) {
        lines.push(format!("            {fenced} pushes refused of a RIB whose term was over"));
    }
    for tier in items(&status["tiers"]) {
        let refused: u64 =
            tier["refused"].as_object().into_iter().flatten().filter_map(|(_, count)| count.as_u64()).sum();
        lines.push(format!(
            "domain      {} {}: {}, {} entries in, {} out, {refused} refused{}",
            text(&tier["kind"]),
            short(&tier["domain"]),
            text(&tier["state"]),
            tier["entries_in"],
            tier["entries_out"],
            tier["reason"].as_str().map(|reason| format!(": {reason}")).unwrap_or_default()
        ));
    }
    lines.push(format!("FIB         {} names, generation {}", status["fib"]["names"], status["fib"]["generation"]));
    let links: Vec<_> = items(&status["links"])
        .iter()
        .map(|link| {
            let rtt = format!("{} µs", link["rtt_us"]);
            [
                short(&link["peer"]),
                text(&link["role"]),
                text(&link["via"]),
                text(&link["address"]),
                link["mtu"].to_string(),
                rtt,
            ]
        })
        .collect();
    lines.push(String::new());
    lines.extend(table(["link to", "role", "via", "address", "MTU", "RTT"], &links));
    for link in items(&status["links_held"]) {
        lines.push(format!("holding an earlier link of {} {}", text(&link["role"]), short(&link["peer"])));
    }
    for link in items(&status["links"]).into_iter().chain(items(&status["links_held"])) {
        for (code, count) in link["errors_received"].as_object().into_iter().flatten() {
            lines.push(format!("{} refused frames of this switch: {count} × {code}", short(&link["peer"])));
        }
    }
    let handshakes = &status["handshakes"];
    if handshakes.as_object().into_iter().flatten().any(|(_, count)| *count != 0) {
        lines.push(format!(
            "handshakes of peers: {} had to prove an address, {} refused, {} gave way to newer ones, {} failed",
            handshakes["challenged"], handshakes["refused"], handshakes["displaced"], handshakes["failed"]
        ));
    }
    let counted = status["counters_by_plane"].as_object().into_iter().flatten();
    let has_dpdk = !status["counters_by_plane"]["forwarded"]["dpdk"].is_null();
    let first = if has_dpdk { "dpdk" } else { "kernel" };
    let counters: Vec<_> = counted
        .map(|(name, planes)| (name, planes[first].as_u64().unwrap_or(0), planes["userspace"].as_u64().unwrap_or(0)))
        .filter(|(_, first, userspace)| *first != 0 || *userspace != 0)
        .map(|(name, first, userspace)| [name.clone(), first.to_string(), userspace.to_string()])
        .collect();
    if !counters.is_empty() {
        lines.push(String::new());
        lines.extend(table(["frames", first, "userspace"], &counters));
    }
    let busiest: Vec<_> =
        items(&status["busiest"]).iter().map(|name| [short(&name["name"]), name["frames"].to_string()]).collect();
    if !busiest.is_empty() {
        lines.push(String::new());
        lines.extend(table(["busiest names", "frames, about"], &busiest));
    }
    for interface in items(&status["interfaces"]).iter().filter(|interface| interface["redirect_lost"] != 0) {
        let (lost, name) = (&interface["redirect_lost"], text(&interface["interface"]));
        lines.push(format!(
            "{lost} frames lost that {name} did not take; `gdp-ctl doctor --interface {name}` looks for the cause"
        ));
    }
    for interface in items(&status["interfaces"]) {
        let (device, name) = (&interface["device"], text(&interface["interface"]));
        for (counter, what) in [("missed", "arrived and were lost in"), ("failed", "were not sent by")] {
            if let Some(count) = device[counter].as_u64().filter(|count| *count > 0) {
                lines.push(format!("{count} packets {what} the device of {name}"));
            }
        }
    }
    for warning in items(&status["warnings"]) {
        lines.push(describe_warning(&warning));
    }
    for error in items(&status["errors"]) {
        lines.push(format!("error: {}", text(&error)));
    }
    lines
}

fn describe_warning(warning: &Value) -> String {
    let names = warning["names"].as_array().map_or(&[][..], Vec::as_slice);
    match warning["kind"].as_str() {
        Some("silent") => format!(
            "warning: {} may send to {} names that somebody takes, and no frame of it has come for {} s",
            short(&warning["entity"]),
            warning["names"],
            warning["for_s"]
        ),
        Some("unserved") => format!(
            "warning: {} names are read or called, and nobody publishes or serves them: {}{}",
            warning["count"],
            names.iter().map(short).collect::<Vec<_>>().join(" "),
            if warning["count"].as_u64() > Some(names.len() as u64) { " …" } else { "" }
        ),
        _ => format!("warning: {warning}"),
    }
}
