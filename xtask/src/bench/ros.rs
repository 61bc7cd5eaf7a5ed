//! Measures ROS 2 messages through two proxies. Compares them with the same DDS programs over
//! kernel routers, and with two zenoh bridges.
//!
//! ```text
//!  gdp    talker ─lo─ gdp-proxy ──── s1 ── s2 ── s3 ──── gdp-proxy ─lo─ listener     (XDP)
//!  gdp-udp the same, with the frames in UDP over IPv4
//!  zenoh  talker ─lo─ zenoh-bridge ─ r1 ── r2 ── r3 ─ zenoh-bridge ─lo─ listener     (kernel IPv4; TLS on both sides, or in clear)
//!  ip     talker ─────────────────── r1 ── r2 ── r3 ─────────────────── listener     (kernel IPv4, in clear)
//!  local  talker ─lo─ listener                                                       (one host, in clear)
//!  tcp    talker ─────────────────── r1 ── r2 ── r3 ─────────────────── listener     (kernel IPv4, one connection, no DDS)
//! ```
//!
//! Both ends are Cyclone DDS. Loads with a high rate use Fast DDS, because its program is compiled.
//! With `--hogs`, busy loops compete with everything for the processors.
//!
//! Zenoh has no such loads, because it carries only topics of a ROS node, and only the Cyclone
//! program is one. Processor time is that of the programs between the two ends: proxies and daemons
//! of switches, or bridges. The kernel's time for forwarding frames does not count.

mod zenoh;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, bail};
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::netns::{self, Namespace};
use gdp_tests::peers::{self, Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program};
use gdp_tests::system_calls::SystemCalls;
use gdp_tests::{Tools, wait};
use serde::Serialize;

use self::zenoh::Bridges;
use crate::build::{self, Executables, Features};
use crate::peers as peer_programs;
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Duration of each load per path and round, in seconds
    #[arg(long, default_value_t = 10)]
    seconds: u32,
    /// Number of alternating measurements per path
    #[arg(long, default_value_t = 2)]
    rounds: u32,
    /// Message size to measure, in bytes; repeat for several. Default: all sizes
    #[arg(long = "bytes")]
    bytes: Vec<usize>,
    /// Path to measure; repeat for several. Default: all paths
    #[arg(long = "path", value_enum)]
    paths: Vec<RosRoute>,
    /// Number of busy loops beside each measurement
    #[arg(long, default_value_t = 0)]
    hogs: u32,
    /// MTU of all interfaces between the two hosts, in bytes
    #[arg(long, default_value_t = 1500)]
    mtu: u32,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    checked: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(super) enum RosRoute {
    Gdp,
    GdpUdp,
    Ip,
    Local,
    Tcp,
    ZenohTls,
    Zenoh,
}

const ROUTES: [RosRoute; 7] = [
    RosRoute::Gdp,
    RosRoute::GdpUdp,
    RosRoute::Ip,
    RosRoute::Local,
    RosRoute::Tcp,
    RosRoute::ZenohTls,
    RosRoute::Zenoh,
];

/// Messages of one size at one rate.
pub(super) struct Load {
    pub bytes: usize,
    /// Messages per second, on all topics together.
    pub rate: f64,
    pub topics: u32,
    pub depth: u32,
    pub vendor: Vendor,
}

const LOADS: [Load; 8] = [
    Load { bytes: 64, ..LOAD },
    Load { bytes: 8_000, ..LOAD },
    Load { bytes: 1_000_000, ..LOAD },
    Load { bytes: 6_000_000, ..LOAD },
    // A point cloud with the QoS that ROS drivers use.
    Load { bytes: 6_000_000, rate: 10.0, depth: 5, ..LOAD },
    Load { bytes: 6_000_000, rate: 10.0, depth: 5, vendor: Vendor::FastDds, ..LOAD },
    Load { bytes: 64, rate: 5_000.0, vendor: Vendor::FastDds, ..LOAD },
    Load { bytes: 64, rate: 20_000.0, topics: 20, vendor: Vendor::FastDds, ..LOAD },
];

pub(super) const LOAD: Load = Load { bytes: 0, rate: 30.0, topics: 1, depth: 10, vendor: Vendor::Cyclone };

impl Load {
    fn is_carried_by(&self, route: RosRoute) -> bool {
        self.vendor == Vendor::Cyclone || !matches!(route, RosRoute::Tcp | RosRoute::ZenohTls | RosRoute::Zenoh)
    }
}

#[derive(Serialize)]
struct RosRow {
    route: RosRoute,
    bytes: usize,
    /// Messages per second, on all topics together.
    rate: f64,
    topics: u32,
    vendor: &'static str,
    sent: u64,
    received: u64,
    /// Number of messages that arrived damaged.
    damaged: u64,
    /// Latency from `write` to the callback, in microseconds.
    latency_us: Latency,
    /// Processor time per message in microseconds, or `None` over routers.
    cpu_us: Option<f64>,
    /// Wake-ups of both proxies or bridges per message: the voluntary context switches of their
    /// threads.
    wakeups: Option<f64>,
    /// System calls of both per message, or `None` where the kernel does not count them.
    system_calls: Option<f64>,
}

#[derive(Serialize)]
struct Latency {
    p50: f64,
    p90: f64,
    p99: f64,
    max: f64,
}

/// The result of one conversation.
#[derive(Default)]
pub(super) struct Measured {
    pub received: Vec<Received>,
    pub cpu: Option<Duration>,
    pub wakeups: Option<u64>,
    pub system_calls: Option<u64>,
    /// Frames that the sending proxy sent again.
    pub repeated: Option<u64>,
}

pub fn run(options: Options) -> Result<()> {
    if !workspace::is_root() {
        bail!("network namespaces need root");
    }
    let routes = if options.paths.is_empty() { ROUTES.to_vec() } else { options.paths };
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    let bench = Bench { mtu: options.mtu, ..Bench::prepare(&routes, profile)? };
    let _hogs = Hog::several(options.hogs)?;
    let mut rows = Vec::new();
    for load in LOADS.iter().filter(|load| options.bytes.is_empty() || options.bytes.contains(&load.bytes)) {
        let routes: Vec<RosRoute> = routes.iter().copied().filter(|route| load.is_carried_by(*route)).collect();
        let count = (load.rate * f64::from(options.seconds)).ceil() as u64;
        let mut samples: Vec<Vec<Measured>> = routes.iter().map(|_| Vec::new()).collect();
        for _ in 0..options.rounds {
            for (route, all) in routes.iter().zip(&mut samples) {
                eprintln!(
                    "{count} messages of {} B at {} Hz on {} topics: {}",
                    load.bytes,
                    load.rate,
                    load.topics,
                    name(*route)
                );
                all.push(bench.measure(*route, load, count)?);
            }
        }
        let sent = count * u64::from(options.rounds);
        rows.extend(routes.iter().zip(&samples).map(|(route, all)| row(*route, load, sent, all)));
    }
    if options.json {
        println!("{}", serde_json::json!({ "bench": "ros", "switches": 3, "rows": rows }));
    } else {
        print_table(&rows);
    }
    Ok(())
}

pub(super) struct Bench {
    tools: Tools,
    bridge: Option<PathBuf>,
    mtu: u32,
}

impl Bench {
    /// Builds the programs of these routes, and removes namespaces of earlier runs.
    pub fn prepare(routes: &[RosRoute], profile: Profile) -> Result<Self> {
        setup::ensure(Purpose::Bench)?;
        if routes.iter().any(|route| matches!(route, RosRoute::Gdp | RosRoute::GdpUdp)) {
            build::executables(Executables::All, profile, Features::default())?;
        }
        peer_programs::build_dds()?;
        let bridge = if routes.iter().any(|route| matches!(route, RosRoute::Zenoh | RosRoute::ZenohTls)) {
            Some(peer_programs::build_zenoh()?)
        } else {
            None
        };
        wait::catch_interrupts();
        netns::sweep()?;
        Ok(Self { tools: workspace::tools(profile), bridge, mtu: ChainOptions::default().mtu })
    }

    pub fn measure(&self, route: RosRoute, load: &Load, count: u64) -> Result<Measured> {
        let on_loopback = load.vendor == Vendor::Cyclone && route != RosRoute::Ip;
        let Load { bytes: size, rate, topics, depth, .. } = *load;
        let traffic = Traffic { count, rate, size, topics, depth, on_loopback, ..Default::default() };
        match route {
            RosRoute::Gdp | RosRoute::GdpUdp => {
                let (udp, chain) = (route == RosRoute::GdpUdp, self.chain());
                let options = FabricOptions { topics, udp, chain, ..Default::default() };
                let mut fabric = Fabric::start(self.tools.clone(), options)?;
                fabric.start_proxies()?;
                let ends = [(fabric.chain.robot(), &traffic), (fabric.chain.cloud(), &traffic)];
                let between = Between {
                    proxies: fabric.robot.iter().chain(&fabric.cloud).collect(),
                    switches: fabric.switches.iter().map(|switch| &switch.process).collect(),
                };
                let measured = converse(&self.tools, load.vendor, ends, &between, fabric.folder())?;
                Ok(Measured { repeated: Some(repeated(&fabric)), ..measured })
            }
            RosRoute::Tcp => {
                let (chain, folder) = (self.routers()?, logs()?);
                let (_, cloud) = chain.ip_ends();
                let talks = Traffic { peer: Some(cloud), ..traffic.clone() };
                let ends = [(chain.robot(), &talks), (chain.cloud(), &traffic)];
                converse(&self.tools, Vendor::Tcp, ends, &Between::default(), folder.path())
            }
            RosRoute::Ip => {
                let chain = self.routers()?;
                let (robot, cloud) = chain.ip_ends();
                // DDS finds its peers by multicast, which routers do not forward. So each side gets
                // the address of the other.
                let talks = Traffic { peer: Some(cloud), ..traffic.clone() };
                let hears = Traffic { peer: Some(robot), ..traffic };
                let folder = logs()?;
                converse(
                    &self.tools,
                    load.vendor,
                    [(chain.robot(), &talks), (chain.cloud(), &hears)],
                    &Between::default(),
                    folder.path(),
                )
            }
            RosRoute::Local => {
                let (host, folder) = (Namespace::create("local")?, logs()?);
                host.enable_loopback_multicast()?;
                let ends = [(&host, &traffic), (&host, &traffic)];
                converse(&self.tools, load.vendor, ends, &Between::default(), folder.path())
            }
            RosRoute::ZenohTls | RosRoute::Zenoh => {
                let Some(bridge) = &self.bridge else { bail!("the bridge was not built") };
                let (chain, folder) = (self.routers()?, logs()?);
                let bridges = Bridges::start(bridge, &chain, route == RosRoute::ZenohTls, folder.path())?;
                let talks = Traffic { node: Some("talker".into()), ..traffic.clone() };
                let hears = Traffic { node: Some("listener".into()), ..traffic };
                let ends = [(chain.robot(), &talks), (chain.cloud(), &hears)];
                let between = Between { proxies: bridges.processes(), ..Between::default() };
                converse(&self.tools, load.vendor, ends, &between, folder.path())
            }
        }
    }
}

impl Bench {
    fn chain(&self) -> ChainOptions {
        ChainOptions { mtu: self.mtu, ..ChainOptions::default() }
    }

    fn routers(&self) -> Result<Chain> {
        let chain = Chain::build(self.chain())?;
        chain.become_ip_routers()?;
        for end in [chain.robot(), chain.cloud()] {
            end.enable_loopback_multicast()?;
        }
        Ok(chain)
    }
}

/// The programs between the two DDS programs, whose processor time counts.
#[derive(Default)]
struct Between<'a> {
    /// Proxies or bridges, whose wake-ups and system calls count as well.
    proxies: Vec<&'a Process>,
    switches: Vec<&'a Process>,
}

/// Runs one conversation.
fn converse(
    tools: &Tools,
    vendor: Vendor,
    [(from, talks), (to, hears)]: [(&Namespace, &Traffic); 2],
    between: &Between<'_>,
    folder: &Path,
) -> Result<Measured> {
    let talker = Side { at: from, vendor, traffic: talks };
    let listener = Side { at: to, vendor, traffic: hears };
    let mut both = match Conversation::start(tools, talker, listener, folder) {
        Ok(both) => both,
        // A failure is also a row, so that a load that is too high for one path does not end the
        // benchmark.
        Err(error) => {
            wait::check_interrupt()?;
            eprintln!("nothing arrives: {error:#}");
            return Ok(Measured::default());
        }
    };
    let system_calls = SystemCalls::of(&between.proxies)?;
    let (before, woken) = (between.cpu()?, between.wakeups()?);
    both.open()?;
    let sending = Duration::from_secs_f64(talks.count as f64 / talks.rate);
    let received = both.finish(sending, Duration::from_secs(10))?;
    let (taken, woken) = (between.cpu()?.saturating_sub(before), between.wakeups()?.saturating_sub(woken));
    let system_calls = system_calls.map(|calls| calls.read()).transpose()?;
    if between.proxies.is_empty() {
        return Ok(Measured { received, ..Measured::default() });
    }
    Ok(Measured { received, cpu: Some(taken), wakeups: Some(woken), system_calls, repeated: None })
}

impl Between<'_> {
    fn cpu(&self) -> Result<Duration> {
        self.proxies.iter().chain(&self.switches).map(|process| process.cpu()).sum()
    }

    fn wakeups(&self) -> Result<u64> {
        self.proxies.iter().map(|process| Ok(process.wakeups()?.values().sum::<u64>())).sum()
    }
}

fn logs() -> Result<tempfile::TempDir> {
    Ok(tempfile::Builder::new().prefix("gdp-bench-").tempdir()?)
}

fn row(route: RosRoute, load: &Load, sent: u64, all: &[Measured]) -> RosRow {
    let messages = || all.iter().flat_map(|measured| &measured.received);
    let mut sorted: Vec<Duration> = messages().map(|message| message.latency).collect();
    sorted.sort();
    let received = sorted.len() as u64;
    let at = |percent| peers::percentile(&sorted, percent).as_nanos() as f64 / 1000.0;
    let latency_us = Latency { p50: at(50.0), p90: at(90.0), p99: at(99.0), max: at(100.0) };
    let cpu: Option<Duration> = all.iter().map(|measured| measured.cpu).sum();
    let cpu_us = cpu.filter(|_| received > 0).map(|taken| taken.as_secs_f64() * 1e6 / received as f64);
    let each = |total: Option<u64>| total.filter(|_| received > 0).map(|total| total as f64 / received as f64);
    let wakeups = each(all.iter().map(|measured| measured.wakeups).sum());
    let system_calls = each(all.iter().map(|measured| measured.system_calls).sum());
    let damaged = messages().filter(|message| !message.intact).count() as u64;
    let Load { bytes, rate, topics, vendor, .. } = *load;
    let vendor = vendor_name(vendor);
    RosRow { route, bytes, rate, topics, vendor, sent, received, damaged, latency_us, cpu_us, wakeups, system_calls }
}

fn name(route: RosRoute) -> &'static str {
    match route {
        RosRoute::Gdp => "gdp: proxy, 3 XDP switches, proxy",
        RosRoute::GdpUdp => "gdp: the same, over UDP",
        RosRoute::Ip => "ip: 3 kernel routers, in clear",
        RosRoute::Local => "local: one host, in clear",
        RosRoute::Tcp => "tcp: 3 kernel routers, in clear",
        RosRoute::ZenohTls => "zenoh: two bridges, 3 routers, TLS",
        RosRoute::Zenoh => "zenoh: two bridges, 3 routers",
    }
}

fn vendor_name(vendor: Vendor) -> &'static str {
    match vendor {
        Vendor::Cyclone => "cyclone",
        Vendor::FastDds => "fastdds",
        Vendor::Tcp => "tcp",
    }
}

/// Returns the frames that the robot's proxy has sent again, by its statistics at its end.
fn repeated(fabric: &Fabric) -> u64 {
    let topics = fabric.proxy_stats("robot")["topics"].as_array().cloned().unwrap_or_default();
    topics.iter().filter_map(|topic| topic["fabric"]["repeated"].as_u64()).sum()
}

/// A busy loop, until it is dropped.
pub(super) struct Hog(std::process::Child);

impl Hog {
    pub fn several(count: u32) -> Result<Vec<Self>> {
        (0..count).map(|_| Self::start()).collect()
    }

    fn start() -> Result<Self> {
        let mut command = Program::Sh.command();
        Ok(Self(command.args(["-c", "while :; do :; done"]).spawn()?))
    }
}

impl Drop for Hog {
    fn drop(&mut self) {
        // It may have been killed already.
        _ = self.0.kill();
        _ = self.0.wait();
    }
}

fn print_table(rows: &[RosRow]) {
    println!("ROS 2 messages, one way, in microseconds; processor time of what stands between the two DDS programs;");
    println!("wake-ups and system calls of both proxies or bridges, per message");
    println!(
        "{:<36} {:>8} {:>8} {:>6} {:>6} {:>13} {:>8} {:>8} {:>8} {:>8} {:>9} {:>8} {:>8}",
        "path", "vendor", "bytes", "Hz", "topics", "recv/sent", "p50", "p90", "p99", "max", "CPU", "wake-ups", "calls"
    );
    for row in rows {
        let (l, got) = (&row.latency_us, format!("{}/{}", row.received, row.sent));
        let cpu = row.cpu_us.map_or_else(|| "-".to_owned(), |cpu| format!("{cpu:.0}"));
        let each = |count: Option<f64>| count.map_or_else(|| "-".to_owned(), |count| format!("{count:.1}"));
        let (wakeups, calls) = (each(row.wakeups), each(row.system_calls));
        println!(
            "{:<36} {:>8} {:>8} {:>6} {:>6} {got:>13} {:>8.0} {:>8.0} {:>8.0} {:>8.0} {cpu:>9} {wakeups:>8} {calls:>8}",
            name(row.route),
            row.vendor,
            row.bytes,
            row.rate,
            row.topics,
            l.p50,
            l.p90,
            l.p99,
            l.max
        );
    }
}
