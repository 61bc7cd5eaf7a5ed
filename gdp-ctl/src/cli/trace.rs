//! `gdp-ctl trace`: every switch on the data path to a name, with the time to each.

use clap::Args;
use gdp_wire::Name;
use serde_json::{Value, json};

use super::Context;
use super::output::short;
use super::place::{self, Place, millis};
use crate::admin::{Client, Request};

/// Probes for one hop, until one is answered.
const TRIES: usize = 3;

/// Hops in a row that nothing answers from: then nothing further on is asked.
const SILENT: usize = 4;

/// Show every switch that frames for a name cross from here, and the time to each.
///
/// A probe goes the way of the name's frames in the data plane, first one switch far, then two, and so on; the switch where it ends answers
/// through the switches' daemons. So a time is that of the way there in the data plane, and of the way back between daemons. The daemon's
/// switch must know a way to the name: somebody who sends to it is attached there, or NAME is a switch. Where the name leaves
/// for other domains, these are shown, and what is inside them is not.
#[derive(Debug, Args)]
pub struct Options {
    /// A name, the first digits of one, or a name card.
    #[arg(value_name = "NAME|PREFIX|CARD")]
    what: String,
    /// Look no further than so many switches.
    #[arg(long, default_value_t = 64, value_name = "HOPS", value_parser = clap::value_parser!(u8).range(1..=64))]
    max_hops: u8,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut client = context.client()?;
    let place = place::find(&options.what, &mut client)?;
    let mut paths = Vec::new();
    if place.egress.is_empty() {
        // An endpoint whose link is here, and to which nobody here may send.
        paths.push(json!({"egress": place.own, "reached": true, "hops": [own(&place)]}));
    }
    for egress in &place.egress {
        paths.push(follow(&place, *egress, options.max_hops, &mut client)?);
    }
    let reached = paths.iter().all(|path| path["reached"] == true);
    context.output.print(json!({"name": place.name, "paths": paths}), || describe(&place.name, &paths))?;
    if reached { Ok(()) } else { anyhow::bail!("the probes did not get to every switch where {:#} is", place.name) }
}

/// The path to one egress switch.
fn follow(place: &Place, egress: Name, max_hops: u8, client: &mut Client) -> anyhow::Result<Value> {
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
    Ok(json!({"egress": egress, "reached": reached, "hops": hops}))
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
fn own(place: &Place) -> Value {
    let is_end = place.egress.is_empty() || place.egress.contains(&place.own);
    let end = if is_end { place.end.clone() } else { Value::Null };
    json!({"hop": 0, "switch": place.own, "rtt_us": 0, "end": end})
}

fn describe(name: &Name, paths: &[Value]) -> String {
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
        if path["reached"] != true {
            lines.push("    nothing further on answers".into());
        }
    }
    lines.join("\n")
}

/// What the last switch delivers to.
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
mod tests {
    use super::*;

    #[test]
    fn a_path_is_told_hop_by_hop() {
        let name = |i: u8| Name::from_bytes([i; 32]);
        let beyond = json!([{"domain": name(8), "switch": name(9)}]);
        let paths = [json!({"egress": name(3), "reached": true, "hops": [
            {"hop": 0, "switch": name(1), "rtt_us": 0, "end": null},
            {"hop": 1, "switch": null, "rtt_us": null, "end": null},
            {"hop": 2, "switch": name(3), "rtt_us": 1234, "end": {"links": 1, "beyond": beyond}},
        ]})];
        let text = describe(&name(7), &paths);
        let lines: Vec<_> = text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
        assert_eq!(lines[1], format!("0 {:#} this switch", name(1)));
        assert_eq!(lines[2], "1 * no answer");
        assert_eq!(
            lines[3],
            format!("2 {:#} 1.234 ms → 1 local link, domain {:#} by its switch {:#}", name(3), name(8), name(9))
        );
    }
}
