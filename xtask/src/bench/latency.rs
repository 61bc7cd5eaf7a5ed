//! One-way latency from a DDS program's `write` to another's callback, over three switches and over
//! three routers.
//!
//! ```text
//!  gdp   talker ─lo─ gdp-proxy ── s1 ── s2 ── s3 ── gdp-proxy ─lo─ listener     (XDP)
//!  site  talker ─lo─ listener                                                   (no network: what DDS itself takes)
//!  ip    talker ──────────────── r1 ── r2 ── r3 ─────────────────── listener     (kernel IPv4, in clear)
//! ```
//!
//! Everything is measured twice: on the unchanged machine, and with processors kept awake by
//! threads of idle priority. The difference is the cost of waking a sleeping processor, once at
//! each handover between threads. On virtual machines it is high, and none of these programs causes
//! it.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use anyhow::{Result, bail};
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::netns::{self, Namespace};
use gdp_tests::peers::{self, Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program};
use gdp_tests::{Tools, wait};
use serde::Serialize;

use crate::build::{self, Executables, Features};
use crate::peers as peer_programs;
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Number of messages of each size, per path and round
    #[arg(long, default_value_t = 300)]
    count: u64,
    /// Number of alternating measurements per path
    #[arg(long, default_value_t = 2)]
    rounds: u32,
    /// Path to measure; repeat for several. Default: all paths
    #[arg(long = "path", value_enum)]
    paths: Vec<LatencyRoute>,
}

/// Bytes per message, and messages per second.
const LOADS: [(usize, f64); 3] = [(64, 100.0), (8_000, 100.0), (1 << 20, 10.0)];

#[derive(Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
enum LatencyRoute {
    Gdp,
    Ip,
    Site,
}

#[derive(Serialize)]
struct LatencyRow {
    route: LatencyRoute,
    /// Whether the processors were kept awake.
    awake: bool,
    bytes: usize,
    rate: f64,
    sent: u64,
    received: u64,
    latency_us: Latency,
    /// Median latency of each stage in microseconds, from the proxies of the fabric. It is empty
    /// for other paths.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    stages_us: BTreeMap<&'static str, f64>,
}

/// The result of one conversation.
struct Measured {
    received: Vec<Received>,
    stages: BTreeMap<&'static str, f64>,
}

#[derive(Serialize)]
struct Latency {
    mean: f64,
    p50: f64,
    p90: f64,
    p99: f64,
    max: f64,
}

pub fn run(options: Options) -> Result<()> {
    if !workspace::is_root() {
        bail!("network namespaces need root");
    }
    let routes = if options.paths.is_empty() {
        vec![LatencyRoute::Gdp, LatencyRoute::Ip, LatencyRoute::Site]
    } else {
        options.paths
    };
    setup::ensure(Purpose::Bench)?;
    if routes.contains(&LatencyRoute::Gdp) {
        build::executables(Executables::All, Profile::Dist, Features::default())?;
    }
    peer_programs::build_dds()?;
    wait::catch_interrupts();
    netns::sweep()?;
    let tools = workspace::tools(Profile::Dist);
    let mut rows = Vec::new();
    for awake in [false, true] {
        let _awake = awake.then(keep_awake).transpose()?;
        for (bytes, rate) in LOADS {
            // A megabyte is sent ten times per second, so fewer messages keep the measurement
            // short.
            let count = if bytes > 100_000 { options.count.div_ceil(3) } else { options.count };
            let mut samples: Vec<Vec<Measured>> = routes.iter().map(|_| Vec::new()).collect();
            for _ in 0..options.rounds {
                for (route, all) in routes.iter().zip(&mut samples) {
                    all.push(measure(&tools, *route, bytes, rate, count)?);
                }
            }
            let sent = count * u64::from(options.rounds);
            rows.extend(routes.iter().zip(samples).map(|(route, all)| row(*route, awake, bytes, rate, sent, all)));
        }
    }
    if options.json {
        println!("{}", serde_json::json!({ "bench": "latency", "switches": 3, "rows": rows }));
    } else {
        print_table(&rows);
    }
    Ok(())
}

fn measure(tools: &Tools, route: LatencyRoute, bytes: usize, rate: f64, count: u64) -> Result<Measured> {
    eprintln!("{count} messages of {bytes} B over {}", name(route));
    let plain = |received| Measured { received, stages: BTreeMap::new() };
    let traffic = Traffic { count, rate, size: bytes, ..Default::default() };
    match route {
        LatencyRoute::Gdp => {
            let mut fabric = Fabric::start(tools.clone(), FabricOptions::default())?;
            fabric.start_proxies()?;
            let (robot, cloud) = (fabric.chain.robot(), fabric.chain.cloud());
            let received = converse(tools, [(robot, &traffic), (cloud, &traffic)], fabric.folder())?;
            let stages = stages(&fabric, received.len() as u64)?;
            Ok(Measured { received, stages })
        }
        LatencyRoute::Ip => {
            let chain = Chain::build(ChainOptions::default())?;
            chain.become_ip_routers()?;
            let (robot, cloud) = chain.ip_ends();
            // DDS finds its peers by multicast, which routers do not forward. So each side gets the
            // address of the other.
            let talks = Traffic { peer: Some(cloud), ..traffic.clone() };
            let hears = Traffic { peer: Some(robot), ..traffic };
            let folder = logs()?;
            converse(tools, [(chain.robot(), &talks), (chain.cloud(), &hears)], folder.path()).map(plain)
        }
        LatencyRoute::Site => {
            let site = Namespace::create("site")?;
            site.enable_loopback_multicast()?;
            let folder = logs()?;
            converse(tools, [(&site, &traffic), (&site, &traffic)], folder.path()).map(plain)
        }
    }
}

fn converse(tools: &Tools, ends: [(&Namespace, &Traffic); 2], folder: &Path) -> Result<Vec<Received>> {
    let [(from, talks), (to, hears)] = ends;
    let talker = Side { at: from, vendor: Vendor::Cyclone, traffic: talks };
    let listener = Side { at: to, vendor: Vendor::FastDds, traffic: hears };
    let mut both = Conversation::start(tools, talker, listener, folder)?;
    both.open()?;
    both.finish(Duration::from_secs_f64(talks.count as f64 / talks.rate), Duration::from_secs(10))
}

/// Returns the median latency of each stage, once both proxies have recorded all messages.
fn stages(fabric: &Fabric, received: u64) -> Result<BTreeMap<&'static str, f64>> {
    let topic = |end: &str| fabric.proxy_stats(end)["topics"][0].clone();
    wait::wait_for("both proxies' statistics", Duration::from_secs(5), || {
        let carried = |end: &str| topic(end)["messages"].as_u64().unwrap_or(0);
        Ok((carried("robot") >= received && carried("cloud") >= received).then_some(()))
    })?;
    let median = |end: &str, stage: &str| topic(end)["latency_us"][stage]["p50"].as_f64();
    let stages = [
        ("1 talker to proxy, by DDS", median("robot", "arrival")),
        ("2 of 3: seal, sign, send", median("robot", "handling")),
        ("3 proxy to proxy", median("cloud", "arrival")),
        ("4 into DDS", median("cloud", "handling")),
    ];
    // RustDDS provides no timestamp for samples that arrive in fragments.
    Ok(stages.into_iter().filter_map(|(stage, p50)| Some((stage, p50?))).collect())
}

/// Starts processes of the lowest priority that keep every processor awake, until they are dropped.
fn keep_awake() -> Result<Vec<Process>> {
    let folder = std::env::temp_dir();
    let spin = |i| {
        let mut command = Program::Chrt.command();
        command.args(["--idle", "0", Program::Sh.name(), "-c", "while :; do :; done"]);
        Process::spawn(&format!("awake-{i}"), command, &folder)
    };
    (0..std::thread::available_parallelism()?.get()).map(spin).collect()
}

fn logs() -> Result<tempfile::TempDir> {
    Ok(tempfile::Builder::new().prefix("gdp-bench-").tempdir()?)
}

fn row(route: LatencyRoute, awake: bool, bytes: usize, rate: f64, sent: u64, all: Vec<Measured>) -> LatencyRow {
    let mut sorted: Vec<Duration> = all.iter().flat_map(|m| &m.received).map(|m| m.latency).collect();
    let received = sorted.len() as u64;
    sorted.sort();
    let at = |percent| micros(peers::percentile(&sorted, percent));
    let mean = sorted.iter().map(|d| micros(*d)).sum::<f64>() / sorted.len().max(1) as f64;
    let latency_us = Latency { mean, p50: at(50.0), p90: at(90.0), p99: at(99.0), max: at(100.0) };
    // The stages of the middle round.
    let mut stages: Vec<_> = all.into_iter().map(|m| m.stages).collect();
    let stages_us = stages.swap_remove(stages.len() / 2);
    LatencyRow { route, awake, bytes, rate, sent, received, latency_us, stages_us }
}

fn micros(duration: Duration) -> f64 {
    duration.as_nanos() as f64 / 1000.0
}

fn name(route: LatencyRoute) -> &'static str {
    match route {
        LatencyRoute::Gdp => "gdp: proxy, 3 XDP switches, proxy",
        LatencyRoute::Ip => "ip: 3 kernel routers, in clear",
        LatencyRoute::Site => "site: one host, DDS alone",
    }
}

fn print_table(rows: &[LatencyRow]) {
    println!("One-way latency, Cyclone DDS -> Fast DDS, in microseconds");
    for awake in [false, true] {
        println!("\n{}", if awake { "processors kept awake" } else { "machine as it is" });
        println!(
            "{:<34} {:>8} {:>5} {:>11} {:>8} {:>8} {:>8} {:>8}",
            "path", "bytes", "Hz", "recv/sent", "mean", "p50", "p99", "max"
        );
        for row in rows.iter().filter(|row| row.awake == awake) {
            let l = &row.latency_us;
            let got = format!("{}/{}", row.received, row.sent);
            println!(
                "{:<34} {:>8} {:>5} {got:>11} {:>8.0} {:>8.0} {:>8.0} {:>8.0}",
                name(row.route),
                row.bytes,
                row.rate,
                l.mean,
                l.p50,
                l.p99,
                l.max
            );
            for (stage, p50) in &row.stages_us {
                println!("  {stage:<66} {p50:>8.0}");
            }
        }
    }
}
