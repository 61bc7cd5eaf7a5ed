//! `gdp-ctl topic hz`, `bw` and `delay`: statistics of a topic, printed once a second until ^C.

use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use anyhow::bail;
use clap::Args;
use gdp::unstable::SubscribeOptions;
use gdp_core::card::NameCard;
use gdp_e2e::seal::Message;
use gdp_ros::compression::unpacked;
use gdp_ros::roster::ROSTER;
use gdp_util::terminal::note;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use super::super::node::{Definitions, NodeOptions, listen, subscribe, tell_if_silent, unless_interrupted};
use super::super::output::lines_of;
use crate::cli::context::Context;
use crate::ros::fabric::Fabric;
use crate::ros::feed::Decoder;
use crate::ros::{figures::Delays, figures::Intervals, figures::Sizes, figures::Spread, figures::seconds};
use gdp::unstable::called;
use gdp_util::unix_time::unix_time;

const PERIOD: Duration = Duration::from_secs(1);

/// Default numbers of messages in a window, as in ros2cli.
const TIMES: usize = 10_000;
const SIZES: usize = 100;

#[derive(Debug, Args)]
pub struct Options {
    /// Topic: a ROS name, a name, the first digits of a name, or a name card.
    #[arg(value_name = "TOPIC")]
    what: String,
    /// Number of most recent messages to evaluate. Default: 10000 for times, 100 for sizes.
    #[arg(short, long)]
    window: Option<NonZeroUsize>,
    #[command(flatten)]
    node: NodeOptions,
}

#[derive(Debug, Args)]
pub struct DelayOptions {
    #[command(flatten)]
    measure: Options,
    #[command(flatten)]
    definitions: Definitions,
}

impl Options {
    fn window(&self, usual: usize) -> usize {
        self.window.map_or(usual, NonZeroUsize::get)
    }
}

/// Times between messages, or delays of messages.
#[derive(Debug, Serialize, JsonSchema)]
pub struct TimesOutput {
    mean_s: f64,
    min_s: f64,
    max_s: f64,
    std_dev_s: f64,
    /// Number of values.
    window: usize,
}

/// Output of `gdp-ctl topic hz`, once a second.
#[derive(Debug, Serialize, JsonSchema)]
pub struct RateOutput {
    rate_hz: f64,
    #[serde(flatten)]
    times: TimesOutput,
}

/// Output of `gdp-ctl topic bw`, once a second.
#[derive(Debug, Serialize, JsonSchema)]
pub struct BandwidthOutput {
    bytes_per_s: f64,
    /// Number of messages.
    messages: usize,
    mean_bytes: f64,
    min_bytes: usize,
    max_bytes: usize,
}

/// Output of `gdp-ctl topic delay`, once a second.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum DelayOutput {
    Times(TimesOutput),
    /// No message has arrived.
    None {
        window: usize,
    },
}

pub fn hz(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut intervals = Intervals::new(options.window(TIMES));
    measure(options, context, |figure| match figure {
        Figure::Arrivals(at, _) => {
            intervals.record(at);
            Ok(())
        }
        Figure::Show(_) => {
            let Some(spread) = intervals.spread() else { return Ok(()) };
            let rate = if spread.mean > 0.0 { 1e9 / spread.mean } else { 0.0 };
            let output = RateOutput { rate_hz: rate, times: TimesOutput::new(&spread) };
            context.output.print(&output, || [format!("average rate: {rate:.3}"), spread.text()])
        }
    })
}

pub fn bw(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut sizes = Sizes::new(options.window(SIZES));
    context.output.tell(|| format!("Subscribed to [{}]", options.what))?;
    measure(options, context, |figure| match figure {
        Figure::Arrivals(at, message) => {
            match unpacked(message.encoding, message.body.clone()) {
                Ok((_, body)) => sizes.record(at, body.len()),
                Err(error) => note(format_args!("gdp-ctl: {error}")),
            }
            Ok(())
        }
        Figure::Show(at) => {
            let Some(shown) = sizes.bandwidth(at) else { return Ok(()) };
            let output = BandwidthOutput {
                bytes_per_s: shown.bytes_per_s,
                messages: shown.count,
                mean_bytes: shown.mean,
                min_bytes: shown.min,
                max_bytes: shown.max,
            };
            context.output.print(&output, || lines_of(&shown.text()))
        }
    })
}

/// An event, with the time in nanoseconds on a monotonic clock.
enum Figure<'a> {
    Arrivals(u64, &'a Message),
    Show(u64),
}

fn measure(
    options: &Options,
    context: &Context,
    mut take: impl FnMut(Figure<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let all = async |fabric: &Fabric, card: &NameCard| {
        let mut subscription = subscribe(fabric, card, SubscribeOptions::best_effort()).await?;
        let (begun, mut ticks) = (Instant::now(), tokio::time::interval(PERIOD));
        let at = || begun.elapsed().as_nanos() as u64;
        loop {
            tokio::select! {
                received = subscription.recv() => match received {
                    Some(message) if message.encoding == ROSTER => {}
                    Some(message) => take(Figure::Arrivals(at(), &message))?,
                    None => return ended(fabric, card),
                },
                _ = ticks.tick() => take(Figure::Show(at()))?,
            }
        }
    };
    run(options, context, all)
}

pub fn delay(options: &DelayOptions, context: &Context) -> anyhow::Result<()> {
    let DelayOptions { measure: options, definitions } = options;
    let mut decoder = Decoder::new(definitions.load()?);
    let mut delays = Delays::new(options.window(TIMES));
    let all = async |fabric: &Fabric, card: &NameCard| {
        let mut feed = listen(fabric, card, SubscribeOptions::best_effort()).await?;
        let (mut ticks, mut told) = (tokio::time::interval(PERIOD), false);
        loop {
            let heard = tokio::select! {
                heard = feed.next() => heard,
                _ = ticks.tick() => {
                    show_delays(&mut delays, context)?;
                    continue;
                }
            };
            let Some(heard) = heard else { return ended(fabric, card) };
            let stamped = match decoder.decode(&heard) {
                Ok(decoded) => stamp(&decoded.value),
                Err(error) => {
                    note(format_args!("gdp-ctl: {error}"));
                    continue;
                }
            };
            if stamped.is_none() && !std::mem::replace(&mut told, true) {
                note(
                    "gdp-ctl: messages have no header with a stamp: the delay is since they were sent into the fabric",
                );
            }
            let sent = heard.message.latched.map_or(heard.message.timestamp_ns, |first| first.timestamp_ns);
            delays.record((unix_time().as_nanos() as i128 - stamped.unwrap_or(sent.into())) as i64);
        }
    };
    run(options, context, all)
}

fn show_delays(delays: &mut Delays, context: &Context) -> anyhow::Result<()> {
    if delays.is_empty() {
        return Ok(());
    }
    let Some(spread) = delays.spread() else {
        let none = DelayOutput::None { window: 0 };
        return context.output.print(&none, || ["no new messages".to_owned()]);
    };
    let mean = seconds(spread.mean);
    context
        .output
        .print(&DelayOutput::Times(TimesOutput::new(&spread)), || [format!("average delay: {mean:.3}"), spread.text()])
}

/// Returns the stamp in the header of a message, in nanoseconds since 1970.
fn stamp(message: &Value) -> Option<i128> {
    let stamp = message.get("header")?.get("stamp")?;
    let part =
        |names: [&str; 2]| names.iter().find_map(|name| stamp.get(*name)).and_then(Value::as_i64).map(i128::from);
    Some(part(["sec", "secs"])? * 1_000_000_000 + part(["nanosec", "nsecs"])?)
}

impl TimesOutput {
    fn new(spread: &Spread) -> Self {
        Self {
            mean_s: seconds(spread.mean),
            min_s: seconds(spread.min as f64),
            max_s: seconds(spread.max as f64),
            std_dev_s: seconds(spread.deviation),
            window: spread.count,
        }
    }
}

fn run(
    options: &Options,
    context: &Context,
    all: impl AsyncFnOnce(&Fabric, &NameCard) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let either = async |fabric: &Fabric, card: &NameCard| {
        let all = async {
            tokio::select! {
                done = all(fabric, card) => done,
                done = tell_if_silent(fabric, card) => done,
            }
        };
        unless_interrupted(all).await
    };
    options.node.with_card(&options.what, "topic", context, either).map(drop)
}

fn ended<T>(fabric: &Fabric, card: &NameCard) -> anyhow::Result<T> {
    bail!("{} may not be read any more by {:#}", called(card), fabric.node.name())
}
