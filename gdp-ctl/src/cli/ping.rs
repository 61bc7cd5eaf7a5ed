//! `gdp-ctl ping`: tests whether a name's data path answers, and its round-trip time.

use std::time::{Duration, Instant};

use clap::Args;
use gdp_wire::Name;
use gdp_wire::header::INITIAL_HOP_LIMIT;
use schemars::JsonSchema;
use serde::Serialize;

use super::name_location::{Paths, millis, with_paths};
use super::output::{AlreadyPrinted, short};
use crate::cli::context::Context;
use crate::cli::node::NodeOptions;
use gdp_proto::admin::trace::{EchoReply, LocateReply, PathEnd, ProbeReply};

/// Test whether a name answers, once a second.
///
/// If the name is a neighbouring switch or an endpoint with a link to the daemon's switch, the
/// command sends echoes. The data plane at the other end of the link answers them, in the kernel if
/// it runs there, without a daemon. For any other name, the command sends probes in the data plane
/// to each switch that delivers the name. The daemon of that switch answers, through the daemons on
/// the path. For a topic, each of its switches answers; its readers receive no request.
///
/// A machine without a daemon needs --switch, and a key and rights in its keyring. A publisher
/// pings its topic, a reader the topic's publishers, and everybody the switch itself. Times include
/// the link to the switch.
///
/// The command ends after COUNT requests, or at ^C. The exit status is 1 if nothing has answered.
#[derive(Debug, Args)]
pub struct Options {
    /// Name, first digits of a name, or name card.
    #[arg(value_name = "NAME|PREFIX|CARD")]
    what: String,
    /// Number of requests, after which the command ends.
    #[arg(short, long)]
    count: Option<u64>,
    /// Interval between two requests, in seconds (0.02 to 3600).
    #[arg(short, long, default_value_t = 1.0, value_parser = parse_interval)]
    interval: f64,
    #[command(flatten)]
    node: NodeOptions,
}

fn parse_interval(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.02..=3600.0).contains(seconds));
    seconds.ok_or_else(|| format!("{text:?} is not a number of seconds from 0.02 to 3600"))
}

/// Output of `gdp-ctl ping`: a line for each answer, and the statistics.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum PingOutput {
    Answer {
        seq: u64,
        /// The target of the request.
        from: Name,
        /// None without an answer.
        rtt_us: Option<u64>,
        /// Local delivery of the name at that switch.
        end: Option<PathEnd>,
    },
    Statistics {
        name: Name,
        sent: u64,
        received: usize,
        loss_percent: f64,
        min_us: Option<u64>,
        avg_us: Option<u64>,
        max_us: Option<u64>,
    },
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let ping = async |paths: &mut Paths<'_>| ping(options, context, paths).await;
    let (names, has_answer) = with_paths(&options.what, &options.node, context, ping)?;
    match has_answer {
        true => Ok(()),
        false => Err(AlreadyPrinted(format!("nothing answered for {}", short(&names))).into()),
    }
}

/// Sends the requests. Returns the names, and whether anything has answered.
async fn ping(options: &Options, context: &Context, paths: &mut Paths<'_>) -> anyhow::Result<(Vec<Name>, bool)> {
    let locations = paths.locations.clone();
    for location in &locations {
        context.output.tell(|| format!("PING {:#} {}", location.name, how(location)))?;
    }
    let mut tallies: Vec<Tally> = locations.iter().map(|_| Tally::default()).collect();
    for seq in 1..=options.count.unwrap_or(u64::MAX) {
        let begun = Instant::now();
        for (location, tally) in locations.iter().zip(&mut tallies) {
            for from in targets(location) {
                let (rtt_us, end) = ask(location, *from, paths).await?;
                tally.add(rtt_us);
                let line = describe(seq, from, rtt_us, end.as_ref());
                context.output.print(&PingOutput::Answer { seq, from: *from, rtt_us, end }, || [line])?;
            }
        }
        let rest = Duration::from_secs_f64(options.interval).saturating_sub(begun.elapsed());
        if Some(seq) == options.count || interrupted(rest).await? {
            break;
        }
    }
    for (location, tally) in locations.iter().zip(&tallies) {
        context.output.print(&tally.statistics(location.name), || tally.lines(&location.name))?;
    }
    let names = locations.iter().map(|location| location.name).collect();
    Ok((names, tallies.iter().any(|tally| !tally.times.is_empty())))
}

/// Waits; returns whether ^C arrived before the time was over.
async fn interrupted(rest: Duration) -> std::io::Result<bool> {
    tokio::select! {
        result = tokio::signal::ctrl_c() => result.map(|()| true),
        () = tokio::time::sleep(rest) => Ok(false),
    }
}

fn how(location: &LocateReply) -> String {
    match location.egress.len() {
        _ if location.near => "by echoes on its link".into(),
        1 => "by probes to its switch".into(),
        n => format!("by probes to {n} switches"),
    }
}

/// Returns the targets of each round.
fn targets(location: &LocateReply) -> &[Name] {
    if location.near { std::slice::from_ref(&location.name) } else { &location.egress }
}

/// Returns the round-trip time to the target, and the target's local delivery of the name; `None`
/// without an answer.
async fn ask(
    location: &LocateReply,
    target: Name,
    paths: &mut Paths<'_>,
) -> anyhow::Result<(Option<u64>, Option<PathEnd>)> {
    if location.near {
        let EchoReply { rtt_us } = paths.echo(location.name)?;
        return Ok((rtt_us, None));
    }
    let ProbeReply { rtt_us, end, .. } = paths.probe(location, target, INITIAL_HOP_LIMIT).await?;
    // A switch before the end of the path reports no delivery.
    Ok((rtt_us.filter(|_| end.is_some()), end))
}

fn describe(seq: u64, from: &Name, rtt_us: Option<u64>, end: Option<&PathEnd>) -> String {
    let links = end.map_or_else(String::new, |end| format!(" links={}", end.links));
    match rtt_us {
        Some(rtt) => format!("{from:#}: seq={seq}{links} time={}", millis(rtt)),
        None => format!("{from:#}: seq={seq} no answer"),
    }
}

/// Number of requests sent, and the times of the answers in microseconds.
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

    /// Returns the minimum, mean and maximum time.
    fn times(&self) -> Option<[u64; 3]> {
        let (min, max) = (self.times.iter().min()?, self.times.iter().max()?);
        Some([*min, self.times.iter().sum::<u64>() / self.times.len() as u64, *max])
    }

    fn statistics(&self, name: Name) -> PingOutput {
        let [min_us, avg_us, max_us] = self.times().map_or([None; 3], |times| times.map(Some));
        let (sent, received, loss_percent) = (self.sent, self.times.len(), self.loss());
        PingOutput::Statistics { name, sent, received, loss_percent, min_us, avg_us, max_us }
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
