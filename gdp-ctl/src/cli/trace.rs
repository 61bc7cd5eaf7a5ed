//! `gdp-ctl trace`: every switch and domain on the data path to a name, with the time to each.

use clap::Args;
use gdp_proto::control::MAX_PATH;
use gdp_wire::Name;
use serde_json::{Value, json};

use super::name_location::{self, NameLocation, millis};
use super::output::short;
use crate::cli::context::Context;
use crate::client::Client;
use gdp_proto::admin::Request;

/// Probes for one hop, until one is answered.
const TRIES: usize = 3;

/// Hops in a row that nothing answers from: then nothing further on is asked.
const SILENT: usize = 4;

/// Show every switch that frames for a name cross from here, and the time to each.
///
/// A probe goes the way of the name's frames in the data plane, first one switch far, then two, and
/// so on; the switch where it ends answers through the switches' daemons. So a time is that of the
/// way there in the data plane, and of the way back between daemons. The daemon's switch must know
/// a way to the name: somebody who sends to it is attached there, or NAME is a switch. Where the
/// name leaves for another domain, the borders on both sides measure how far it is from one to the
/// other, and that domain says how the name goes on there, in what time, and into which domains;
/// its switches only if it wants to (`trace: open` at its border). A domain answers for names that
/// it takes from this one.
#[derive(Debug, Args)]
pub struct Options {
    /// A name, the first digits of one, or a name card.
    #[arg(value_name = "NAME|PREFIX|CARD")]
    what: String,
    /// Look no further than so many switches of this domain.
    #[arg(long, default_value_t = 64, value_name = "HOPS", value_parser = clap::value_parser!(u8).range(1..=64))]
    max_hops: u8,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut client = context.client()?;
    let place = name_location::find(&options.what, &mut client)?;
    let mut paths = Vec::new();
    if place.egress.is_empty() {
        // An endpoint whose link is here, and to which nobody here may send.
        paths.push(json!({"egress": place.own, "reached": true, "hops": [own(&place)], "domains": []}));
    }
    for egress in &place.egress {
        paths.push(follow(&place, *egress, options.max_hops, &mut client)?);
    }
    let reached = paths.iter().all(|path| path["reached"] == true);
    context.output.print(json!({"name": place.name, "paths": paths}), || describe(&place.name, &paths))?;
    if reached {
        Ok(())
    } else {
        anyhow::bail!("the probes did not get to every switch where {:#} is, or a domain does not tell", place.name)
    }
}

/// The path to one egress switch.
fn follow(place: &NameLocation, egress: Name, max_hops: u8, client: &mut Client) -> anyhow::Result<Value> {
    let mut hops = vec![own(place)];
    let (mut reached, mut silent) = (egress == place.own, 0);
    for hop in 1..=max_hops {
        if reached || silent == SILENT {
            break;
        }
        let answer = ask(&Request::Probe { name: place.name, switch: egress, hops: hop }, client)?;
        reached = !answer["end"].is_null();
        silent = if answer["switch"].is_null() { silent + 1 } else { 0 };
        hops.push(json!({
            "hop": hop, "switch": answer["switch"], "rtt_us": answer["rtt_us"], "end": answer["end"],
        }));
    }
    let domains = beyond(place.name, egress, hops.last(), client)?;
    reached &= domains.iter().all(|domain| domain["outcome"] == "traced" && domain["inside"]["rtt_us"].is_u64());
    Ok(json!({"egress": egress, "reached": reached, "hops": hops, "domains": domains}))
}

/// The domains that the name leaves for at the last switch of a path, and those behind them.
fn beyond(name: Name, border: Name, last: Option<&Value>, client: &mut Client) -> anyhow::Result<Vec<Value>> {
    let mut domains = Vec::new();
    for beyond in last.and_then(|last| last["end"]["beyond"].as_array()).into_iter().flatten() {
        let (domain, peer) = (serde_json::from_value(beyond["domain"].clone())?, &beyond["switch"]);
        let peer = serde_json::from_value(peer.clone())?;
        let answer = client.ask_value(&Request::Beyond { name, border, domain, peer })?;
        domains.extend(answer["domains"].as_array().into_iter().flatten().cloned());
    }
    Ok(domains)
}

fn ask(probe: &Request, client: &mut Client) -> anyhow::Result<Value> {
    let mut answer = Value::Null;
    for _ in 0..TRIES {
        answer = client.ask_value(probe)?;
        if !answer["switch"].is_null() {
            break;
        }
    }
    Ok(answer)
}

/// The daemon's switch is the first on every path.
fn own(place: &NameLocation) -> Value {
    let is_end = place.egress.is_empty() || place.egress.contains(&place.own);
    let end = if is_end { place.end.clone() } else { Value::Null };
    json!({"hop": 0, "switch": place.own, "rtt_us": 0, "end": end})
}

fn describe(name: &Name, paths: &[Value]) -> Vec<String> {
    let mut lines = vec![format!("trace to {name}")];
    for path in paths {
        if paths.len() > 1 {
            lines.push(format!("toward switch {}", short(&path["egress"])));
        }
        for hop in path["hops"].as_array().into_iter().flatten() {
            let number = hop["hop"].as_u64().unwrap_or_default();
            let (who, time) = match hop["rtt_us"].as_u64() {
                Some(_) if number == 0 => (short(&hop["switch"]), "this switch".into()),
                Some(rtt) => (short(&hop["switch"]), millis(rtt)),
                None => ("*".into(), "no answer".into()),
            };
            lines.push(format!("{number:2}  {who:11}  {time}{}", end(&hop["end"])));
        }
        if path["hops"].as_array().and_then(|hops| hops.last()).is_none_or(|last| last["end"].is_null()) {
            lines.push("    nothing further on answers".into());
        }
        path["domains"].as_array().into_iter().flatten().for_each(|domain| cross(domain, &mut lines));
    }
    lines
}

/// A domain: where it is entered, and what is inside.
fn cross(domain: &Value, lines: &mut Vec<String>) {
    let indent = " ".repeat(4 * domain["depth"].as_u64().unwrap_or(1).min(MAX_PATH as u64) as usize);
    let name = short(&domain["domain"]);
    let time = domain["rtt_us"].as_u64().map_or_else(|| "no answer to echoes".into(), millis);
    lines.push(format!("{indent}domain {name}  by its switch {}  {time}", short(&domain["switch"])));
    let why_not = match domain["outcome"].as_str().unwrap_or_default() {
        "traced" => None,
        "refused" => Some(format!("not traced: {}", domain["reason"].as_str().unwrap_or_default())),
        "loop" => Some("not traced: the name has crossed this domain before".into()),
        "too_far" => Some(format!("not traced: the name has crossed {MAX_PATH} domains already")),
        _ => Some("its border does not say what is behind it: no answer in time".into()),
    };
    if let Some(why_not) = why_not {
        lines.push(format!("{indent}  {why_not}"));
        return;
    }
    let inside = &domain["inside"];
    let time = inside["rtt_us"].as_u64().map_or_else(|| "no answer from all of it".into(), millis);
    match inside["hops"].as_array() {
        Some(hops) => {
            for hop in hops {
                let time = hop["rtt_us"].as_u64().map_or_else(|| "no answer".into(), millis);
                let who = if hop["switch"].is_null() { "*".into() } else { short(&hop["switch"]) };
                lines.push(format!("{indent}  {:2}  {who:11}  {time}", hop["hop"].as_u64().unwrap_or_default()));
            }
            lines.push(format!("{indent}  inside of domain {name}  {time}{}", end(inside)));
        }
        None => lines.push(format!("{indent}  … inside of domain {name} (masked)  {time}{}", end(inside))),
    }
}

/// What the last switch, or a domain, delivers to.
fn end(end: &Value) -> String {
    let mut text = match end["links"].as_u64() {
        None => return String::new(),
        Some(1) => "  → 1 local link".to_owned(),
        Some(links) => format!("  → {links} local links"),
    };
    for beyond in end["beyond"].as_array().into_iter().flatten() {
        text += &format!(", domain {} by its switch {}", short(&beyond["domain"]), short(&beyond["switch"]));
    }
    text
}

#[cfg(test)]
#[path = "../../tests/unit/cli/trace.rs"]
mod tests;
