//! `gdp-ctl ping`: whether a name's data path answers, and how fast.

use std::time::{Duration, Instant};

use anyhow::bail;
use clap::Args;
use gdp_wire::Name;
use gdp_wire::header::INITIAL_HOP_LIMIT;
use serde_json::{Value, json};

use super::name_location::{self, NameLocation, millis};
use super::output::short;
use crate::cli::context::Context;
use crate::client::Client;
use gdp_proto::admin::Request;

/// Ask whether a name answers, once a second.
///
/// What has a link with the daemon's switch, a neighbouring switch or an endpoint, is sent echoes:
/// the data plane at the other end answers them, in the kernel where it runs there, and no daemon
/// is asked. Anything else is sent probes, which go in the data plane to each switch where the name
/// is delivered; that switch's daemon answers, through the daemons on the way. A topic answers so
/// for each of its switches, and its readers are not asked. Ends after COUNT, or at ^C; the exit
/// status is 1 if nothing has answered.
#[derive(Debug, Args)]
pub struct Options {
    /// A name, the first digits of one, or a name card.
    #[arg(value_name = "NAME|PREFIX|CARD")]
    what: String,
    /// Stop after so many.
    #[arg(short, long)]
    count: Option<u64>,
    /// Seconds from one to the next.
    #[arg(short, long, default_value_t = 1.0, value_parser = parse_interval)]
    interval: f64,
}

fn parse_interval(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.02..=3600.0).contains(seconds));
    seconds.ok_or_else(|| format!("{text:?} is not a number of seconds from 0.02 to 3600"))
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut client = context.client()?;
    let place = name_location::find(&options.what, &mut client)?;
    if !context.output.json {
        context.output.print(json!({}), || [format!("PING {:#} {}", place.name, how(&place))])?;
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut tally = Tally::default();
    for seq in 1..=options.count.unwrap_or(u64::MAX) {
        let begun = Instant::now();
        for target in targets(&place) {
            let answer = ask(&place, target, &mut client)?;
            tally.add(answer["rtt_us"].as_u64());
            let mut line = json!({"seq": seq, "from": target});
            for key in ["rtt_us", "end"] {
                line[key] = answer[key].clone();
            }
            context.output.print(line.clone(), || [describe(&line)])?;
        }
        let rest = Duration::from_secs_f64(options.interval).saturating_sub(begun.elapsed());
        if Some(seq) == options.count || runtime.block_on(interrupted(rest))? {
            break;
        }
    }
    context.output.print(tally.value(&place.name), || tally.lines(&place.name))?;
    if tally.times.is_empty() { bail!("nothing answered for {:#}", place.name) } else { Ok(()) }
}

/// Whether ^C comes before the time is over.
async fn interrupted(rest: Duration) -> std::io::Result<bool> {
    tokio::select! {
        result = tokio::signal::ctrl_c() => result.map(|()| true),
        () = tokio::time::sleep(rest) => Ok(false),
    }
}

fn how(place: &NameLocation) -> String {
    match place.egress.len() {
        _ if place.is_near => "by echoes on its link".into(),
        1 => "by probes to its switch".into(),
        n => format!("by probes to {n} switches"),
    }
}

/// Whom to ask each time.
fn targets(place: &NameLocation) -> &[Name] {
    if place.is_near { std::slice::from_ref(&place.name) } else { &place.egress }
}

fn ask(place: &NameLocation, target: &Name, client: &mut Client) -> anyhow::Result<Value> {
    if place.is_near {
        return Ok(client.ask_value(&Request::Echo { peer: place.name })?);
    }
    if *target == place.own {
        return Ok(json!({"rtt_us": 0, "end": place.end}));
    }
    let answer = client.ask_value(&Request::Probe { name: place.name, switch: *target, hops: INITIAL_HOP_LIMIT })?;
    // A switch before the end has no end to tell of.
    Ok(if answer["end"].is_null() { json!({}) } else { answer })
}

fn describe(line: &Value) -> String {
    let links = match line["end"]["links"].as_u64() {
        Some(links) => format!(" links={links}"),
        None => String::new(),
    };
    match line["rtt_us"].as_u64() {
        Some(rtt) => format!("{}: seq={}{links} time={}", short(&line["from"]), line["seq"], millis(rtt)),
        None => format!("{}: seq={} no answer", short(&line["from"]), line["seq"]),
    }
}

/// What has been sent, and the times of what was answered, in microseconds.
#[derive(Default)]
struct Tally {
    sent: u64,
    times: Vec<u64>,
}

impl Tally {
    fn add(&mut self, rtt: Option<u64>) {
        self.sent += 1;
        self.times.extend(rtt);
    }

    fn loss(&self) -> f64 {
        let lost = self.sent - self.times.len() as u64;
        100.0 * lost as f64 / self.sent.max(1) as f64
    }

    /// The shortest time, the mean and the longest.
    fn times(&self) -> Option<[u64; 3]> {
        let (min, max) = (self.times.iter().min()?, self.times.iter().max()?);
        Some([*min, self.times.iter().sum::<u64>() / self.times.len() as u64, *max])
    }

    fn value(&self, name: &Name) -> Value {
        let times = self.times();
        let time = |at: usize| times.map(|times| times[at]);
        json!({
            "name": name, "sent": self.sent, "received": self.times.len(), "loss_percent": self.loss(),
            "min_us": time(0), "avg_us": time(1), "max_us": time(2),
        })
    }

    fn lines(&self, name: &Name) -> Vec<String> {
        let mut lines = vec![
            format!("--- {name:#} ping statistics ---"),
            format!("{} sent, {} received, {:.0}% loss", self.sent, self.times.len(), self.loss()),
        ];
        if let Some(times) = self.times() {
            let [min, avg, max] = times.map(|micros| format!("{}.{:03}", micros / 1000, micros % 1000));
            lines.push(format!("rtt min/avg/max = {min}/{avg}/{max} ms"));
        }
        lines
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cli/ping.rs"]
mod tests;
