//! `cargo xtask demo`: a ROS 2 topic of one DDS vendor crosses three XDP switches to the other vendor's listener.
//!
//! Everything runs in network namespaces of its own, with real programs; nothing stays behind, Ctrl-C included.

mod route;

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions, TOPIC, TYPE};
use gdp_tests::packet::{ETHERNET, is_gdp_data};
use gdp_tests::peers::{self, Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::{netns, wait};
use serde::Serialize;
use serde_json::Value;

use self::route::Hop;
use crate::setup::{self, Part};
use crate::workspace::{self, Profile};
use crate::{build, peers as peer_programs};

#[derive(clap::Args)]
pub struct Options {
    /// How long messages flow
    #[arg(long, default_value_t = 10)]
    seconds: u64,
    /// One JSON object on stdout instead of a story
    #[arg(long)]
    json: bool,
    /// Messages per second
    #[arg(long, default_value_t = 20.0)]
    rate: f64,
    /// Bytes of a message
    #[arg(long, default_value_t = 64)]
    size: usize,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    sent: u64,
    received: u64,
    lost: u64,
    latency_us: Latency,
    /// Of the topic, 64 hex digits.
    name: String,
    /// The nodes a message crosses, in order.
    path: Vec<String>,
    /// Data frames that never left the kernel, per switch.
    forwarded_in_kernel: BTreeMap<String, u64>,
    /// Of all switches, as the daemons say it; `mixed` if they differ.
    data_plane: String,
    /// Words looked for in a captured frame, and those that were there (none).
    looked_for: Vec<String>,
    found: Vec<String>,
}

#[derive(Serialize)]
struct Latency {
    p50: f64,
    p90: f64,
    p99: f64,
    max: f64,
}

const TEXT: &str = "hello from the robot";

/// The link between s1 and s2 goes through a bridge, where an eavesdropper listens.
const TAPPED: usize = 1;

pub fn run(options: Options) -> Result<()> {
    ensure!(options.seconds > 0 && options.rate > 0.0, "--seconds and --rate must be above zero");
    if !workspace::is_root() {
        bail!("the demo builds network namespaces and loads XDP programs, which needs root");
    }
    setup::ensure(&[Part::Workspace, Part::Ebpf, Part::Namespaces, Part::Dds])?;
    build::all(Profile::Release)?;
    peer_programs::build()?;
    wait::catch_interrupts();
    netns::sweep()?;
    let story = Story { silent: options.json };
    let outcome = play(&options, &story)?;
    if options.json {
        println!("{}", serde_json::to_string(&outcome)?);
    }
    Ok(())
}

fn play(options: &Options, story: &Story) -> Result<Outcome> {
    story.say("Building   robot ── s1 ──(wire)── s2 ── s3 ── cloud   in network namespaces: Ethernet only, no IP");
    let chain = ChainOptions { wire: Some(TAPPED), ..Default::default() };
    let mut fabric = Fabric::start(workspace::tools(Profile::Release), FabricOptions { chain, ..Default::default() })?;
    fabric.start_proxies()?;
    story.name(&fabric);

    let traffic = Traffic {
        count: ((options.seconds as f64) * options.rate).ceil() as u64,
        rate: options.rate,
        size: options.size,
        text: TEXT.into(),
        ..Default::default()
    };
    story.say("\nTalker: Cyclone DDS in `robot`. Listener: Fast DDS in `cloud`. Neither knows of anything but DDS.\n");
    let talks = Side { at: fabric.chain.robot(), vendor: Vendor::Cyclone, traffic: &traffic };
    let hears = Side { at: fabric.chain.cloud(), vendor: Vendor::FastDds, traffic: &traffic };
    let mut conversation = Conversation::start(&fabric.tools, talks, hears, fabric.folder())?;
    let before = in_kernel(&fabric)?;
    let eavesdropper = fabric.chain.wire_from_robot()?;
    conversation.open()?;
    let frame = eavesdropper.receive(Duration::from_secs(10), is_gdp_data).context("on the wire between s1 and s2")?;
    let received = watch(&mut conversation, Duration::from_secs(options.seconds), story)?;
    let after = in_kernel(&fabric)?;
    let statuses = (0..fabric.switches.len()).map(|i| fabric.status(i)).collect::<Result<Vec<_>>>()?;

    let route = route::follow(&fabric)?;
    let forwarded = before.iter().zip(&after).map(|(before, after)| after - before).collect::<Vec<_>>();
    let outcome = outcome(&fabric, &traffic, &received, &frame, &route, &forwarded, &statuses);
    story.route(&route);
    story.counters(&outcome, &statuses);
    story.latency(&outcome);
    story.capture(&outcome, &frame);
    Ok(outcome)
}

/// Tells of messages while they arrive, and returns all.
fn watch(conversation: &mut Conversation, sending: Duration, story: &Story) -> Result<Vec<Received>> {
    let started = Instant::now();
    let mut next = Duration::ZERO;
    while started.elapsed() < sending {
        wait::check_interrupt()?;
        conversation.listener.check_alive()?;
        conversation.talker.check_alive()?;
        if started.elapsed() >= next
            && let Some(latest) = peers::received(&conversation.listener).last()
        {
            story.message(latest);
            next = started.elapsed() + Duration::from_secs(1);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    conversation.finish(Duration::from_secs(5), Duration::from_secs(5))
}

/// Per switch, data frames forwarded without the daemon.
fn in_kernel(fabric: &Fabric) -> Result<Vec<u64>> {
    (0..fabric.switches.len()).map(|i| fabric.forwarded_in_kernel(i)).collect()
}

fn outcome(
    fabric: &Fabric,
    traffic: &Traffic,
    received: &[Received],
    frame: &[u8],
    route: &[Hop],
    forwarded: &[u64],
    statuses: &[Value],
) -> Outcome {
    let mut sorted: Vec<Duration> = received.iter().map(|message| message.latency).collect();
    sorted.sort();
    let at = |percent| peers::percentile(&sorted, percent).as_nanos() as f64 / 1000.0;
    let arrived = received.iter().filter(|m| m.intact).map(|m| m.sequence).collect::<BTreeSet<_>>().len() as u64;
    let label = |i: usize| format!("s{}", i + 1);
    let planes: Vec<String> = statuses.iter().map(|status| text(&status["data_plane"])).collect();
    let words = [TOPIC, TYPE, TEXT, "chatter", "std_msgs", "String", "hello"];
    Outcome {
        sent: traffic.count,
        received: arrived,
        lost: traffic.count - arrived,
        latency_us: Latency { p50: at(50.0), p90: at(90.0), p99: at(99.0), max: at(100.0) },
        name: fabric.name.clone(),
        path: route.iter().map(|hop| hop.node.clone()).collect(),
        forwarded_in_kernel: forwarded.iter().enumerate().map(|(i, frames)| (label(i), *frames)).collect(),
        data_plane: match planes.as_slice() {
            [first, rest @ ..] if rest.iter().all(|plane| plane == first) => first.clone(),
            _ => "mixed".into(),
        },
        looked_for: words.map(String::from).into(),
        found: words.iter().filter(|word| contains(frame, word.as_bytes())).map(|word| word.to_string()).collect(),
    }
}

fn contains(haystack: &[u8], needle: &[u8]) -> bool {
    haystack.windows(needle.len()).any(|window| window.eq_ignore_ascii_case(needle))
}

fn text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// What people read.
struct Story {
    silent: bool,
}

impl Story {
    fn say(&self, line: &str) {
        if !self.silent {
            println!("{line}");
        }
    }

    fn name(&self, fabric: &Fabric) {
        self.say(&format!(
            "\nThe topic {TOPIC} ({TYPE}) of this owner is now, and for ever, called\n  {}",
            fabric.name
        ));
        self.say("  = SHA-256(\"gdp/name/1\" ‖ owner's public key ‖ SHA-256(metadata)); the switches see only this");
    }

    fn message(&self, message: &Received) {
        let micros = message.latency.as_micros();
        self.say(&format!(
            "  message {:>6}  {:>8} B  {micros:>6} µs after it was written",
            message.sequence, message.bytes
        ));
    }

    fn route(&self, route: &[Hop]) {
        self.say("\nRoute, as the switches' tables have it:");
        for hop in route {
            self.say(&format!("  {:<6} {}", hop.node, hop.what));
        }
    }

    fn counters(&self, outcome: &Outcome, after: &[Value]) {
        self.say("\nData frames forwarded in the kernel, and all that each switch counted since it started:");
        for ((label, frames), status) in outcome.forwarded_in_kernel.iter().zip(after) {
            let counters = status["counters"].as_object().into_iter().flatten();
            let nonzero = counters.filter(|(_, value)| value.as_u64().is_some_and(|n| n > 0));
            let all: Vec<String> = nonzero.map(|(name, value)| format!("{name} {value}")).collect();
            self.say(&format!(
                "  {label}  {:<10} {frames:>8} frames   ({})",
                text(&status["data_plane"]),
                all.join(", ")
            ));
        }
    }

    fn latency(&self, outcome: &Outcome) {
        let Latency { p50, p90, p99, max } = outcome.latency_us;
        self.say(&format!("\n{} sent, {} received, {} lost", outcome.sent, outcome.received, outcome.lost));
        self.say(&format!("One way, DDS to DDS: p50 {p50:.0} µs, p90 {p90:.0} µs, p99 {p99:.0} µs, max {max:.0} µs"));
    }

    fn capture(&self, outcome: &Outcome, frame: &[u8]) {
        self.say(&format!("\nOne frame on the wire between s1 and s2 ({} bytes):", frame.len()));
        let parts = [
            ("Ethernet", 0..ETHERNET),
            ("header", ETHERNET..ETHERNET + 32),
            ("destination name", ETHERNET + 32..ETHERNET + 64),
            ("source name", ETHERNET + 64..ETHERNET + 96),
            ("sealed", ETHERNET + 96..frame.len()),
        ];
        for (what, range) in parts {
            for (i, line) in frame.get(range).unwrap_or_default().chunks(32).enumerate() {
                let hex: String = line.iter().map(|byte| format!("{byte:02x}")).collect();
                self.say(&format!("  {:<17} {hex}", if i == 0 { what } else { "" }));
            }
        }
        let words = outcome.looked_for.join(", ");
        match outcome.found.as_slice() {
            [] => self.say(&format!("Looked for {words}: nothing of it is there.")),
            found => self.say(&format!("FOUND IN CLEAR: {}", found.join(", "))),
        }
    }
}
