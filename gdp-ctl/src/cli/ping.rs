//! `gdp-ctl ping`: tests whether a name's data path answers, and its round-trip time.

use std::time::{Duration, Instant};

use clap::Args;
use gdp_wire::Name;
use gdp_wire::header::INITIAL_HOP_LIMIT;
use schemars::JsonSchema;
use serde::Serialize;

use super::name_location::{self, millis};
use super::output::AlreadyPrinted;
use crate::cli::context::Context;
use crate::client::{Client, ClientError};
use gdp_proto::admin::Request;
use gdp_proto::admin::trace::{EchoReply, LocateReply, PathEnd, ProbeReply};

/// Test whether a name answers, once a second.
///
/// If the name is a neighbouring switch or an endpoint with a link to the daemon's switch, the
/// command sends echoes. The data plane at the other end of the link answers them, in the kernel if
/// it runs there, without a daemon. For any other name, the command sends probes in the data plane
/// to each switch that delivers the name. The daemon of that switch answers, through the daemons on
/// the path. For a topic, each of its switches answers; its readers receive no request.
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
    let mut client = context.client()?;
    let location = name_location::find(&options.what, &mut client)?;
    context.output.tell(|| format!("PING {:#} {}", location.name, how(&location)))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut tally = Tally::default();
    for seq in 1..=options.count.unwrap_or(u64::MAX) {
        let begun = Instant::now();
        for from in targets(&location) {
            let (rtt_us, end) = ask(&location, from, &mut client)?;
            tally.add(rtt_us);
            let line = describe(seq, from, rtt_us, end.as_ref());
            context.output.print(&PingOutput::Answer { seq, from: *from, rtt_us, end }, || [line])?;
        }
        let rest = Duration::from_secs_f64(options.interval).saturating_sub(begun.elapsed());
        if Some(seq) == options.count || runtime.block_on(interrupted(rest))? {
            break;
        }
    }
    context.output.print(&tally.statistics(location.name), || tally.lines(&location.name))?;
    match tally.times.is_empty() {
        true => Err(AlreadyPrinted(format!("nothing answered for {:#}", location.name)).into()),
        false => Ok(()),
    }
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
fn ask(
    location: &LocateReply,
    target: &Name,
    client: &mut Client,
) -> Result<(Option<u64>, Option<PathEnd>), ClientError> {
    if location.near {
        let EchoReply { rtt_us } = client.ask(&Request::Echo { peer: location.name })?;
        return Ok((rtt_us, None));
    }
    if *target == location.own {
        return Ok((Some(0), Some(location.end.clone())));
    }
    let probe = Request::Probe { name: location.name, switch: *target, hops: INITIAL_HOP_LIMIT };
    let ProbeReply { rtt_us, end, .. } = client.ask(&probe)?;
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
