//! The paths on which messages are measured, from one host to another, and the measurement of one
//! load on one path.
//!
//! ```text
//!  gdp      talker ─lo─ gdp-proxy ──── s1 ── s2 ── s3 ──── gdp-proxy ─lo─ listener     (XDP)
//!  gdp-udp  the same, with the frames in UDP over IPv4
//!  zenoh    talker ─lo─ zenoh-bridge ─ r1 ── r2 ── r3 ─ zenoh-bridge ─lo─ listener     (kernel IPv4)
//!  ip       talker ─────────────────── r1 ── r2 ── r3 ─────────────────── listener     (kernel IPv4)
//!  local    talker ─lo─ listener                                                       (one host)
//!  tcp, tls, quinn: as ip, over a connection instead of DDS
//! ```
//!
//! `ip`, `local`, `tcp` and `zenoh` are in clear, the others encrypted.

mod machine;
mod row;
mod secrets;
mod zenoh;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, bail};
use gdp_faults::Faults;
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::netns::{self, Namespace};
use gdp_tests::peers::{Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program};
use gdp_tests::system_calls::SystemCalls;
use gdp_tests::wire::Wire;
use gdp_tests::{Tools, wait};
use serde::Serialize;

use self::machine::MachineTime;
pub use self::row::{PathRow, measure_in_turn, print_table};
use self::zenoh::{Bridges, Security};
use crate::build::{self, Executables, Features};
use crate::peers as peer_programs;
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};

#[derive(Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum BenchRoute {
    Gdp,
    GdpUdp,
    Ip,
    Local,
    Tcp,
    /// TLS over TCP.
    TcpTls,
    /// QUIC, with a stream of messages.
    Quinn,
    /// QUIC, with a stream for each message.
    QuinnStreams,
    Zenoh,
    ZenohTls,
    ZenohTlsLowLatency,
}

impl BenchRoute {
    fn is_gdp(self) -> bool {
        matches!(self, Self::Gdp | Self::GdpUdp)
    }

    fn is_zenoh(self) -> bool {
        matches!(self, Self::Zenoh | Self::ZenohTls | Self::ZenohTlsLowLatency)
    }

    fn is_quinn(self) -> bool {
        matches!(self, Self::Quinn | Self::QuinnStreams)
    }

    fn has_dds(self) -> bool {
        !self.is_quinn() && !matches!(self, Self::Tcp | Self::TcpTls)
    }

    pub fn describe(self) -> &'static str {
        match self {
            Self::Gdp => "gdp: proxy, 3 XDP switches, proxy",
            Self::GdpUdp => "gdp: the same, over UDP",
            Self::Ip => "ip: 3 kernel routers, in clear",
            Self::Local => "local: one host, in clear",
            Self::Tcp => "tcp: 3 kernel routers, in clear",
            Self::TcpTls => "tcp: 3 routers, TLS",
            Self::Quinn => "quinn: 3 routers, one stream",
            Self::QuinnStreams => "quinn: 3 routers, a stream each",
            Self::Zenoh => "zenoh: two bridges, 3 routers",
            Self::ZenohTls => "zenoh: two bridges, 3 routers, TLS",
            Self::ZenohTlsLowLatency => "zenoh: the same, low latency",
        }
    }
}

/// Messages of one size at one rate.
#[derive(Clone, Copy)]
pub struct Load {
    pub bytes: usize,
    /// Messages per second, on all topics together.
    pub rate: f64,
    pub topics: u32,
    pub depth: u32,
    pub vendor: Vendor,
}

pub const LOAD: Load = Load { bytes: 0, rate: 30.0, topics: 1, depth: 10, vendor: Vendor::Cyclone };

impl Load {
    /// Returns whether the path has programs for this load. Zenoh carries only topics of a ROS
    /// node, and only the Cyclone program is one. The TCP programs have one topic.
    pub fn is_carried_by(&self, route: BenchRoute) -> bool {
        match route {
            BenchRoute::Tcp | BenchRoute::TcpTls => self.topics == 1 && self.vendor == Vendor::Cyclone,
            _ => self.vendor == Vendor::Cyclone || !route.is_zenoh(),
        }
    }

    /// Returns the number of messages in some seconds.
    pub fn count(&self, seconds: u32) -> u64 {
        (self.rate * f64::from(seconds)).ceil() as u64
    }
}

/// The cables between the two hosts.
#[derive(Clone, Default)]
pub struct Cables {
    /// MTU, transmit offloads, and where the faults are.
    pub chain: ChainOptions,
    /// Faults of the last cable, the same in both directions.
    pub faults: Option<Faults>,
}

impl Cables {
    /// Returns cables of which the last one has these faults.
    pub fn with_faults(faults: Faults) -> Self {
        let chain = ChainOptions::default();
        Self { chain: ChainOptions { wire: Some(chain.switches), ..chain }, faults: Some(faults) }
    }

    fn disturb(&self, chain: &Chain) -> Result<Option<Wire>> {
        const SEED: u64 = 20;
        let Some(faults) = &self.faults else { return Ok(None) };
        chain.disturb_wire([faults.clone(), faults.clone()], SEED).map(Some)
    }

    fn routers(&self) -> Result<Chain> {
        let chain = Chain::build(self.chain)?;
        chain.become_ip_routers()?;
        for end in [chain.robot(), chain.cloud()] {
            end.enable_loopback_multicast()?;
        }
        Ok(chain)
    }
}

/// What several routes are measured with.
pub struct Cell {
    /// Describes the cables.
    pub name: String,
    pub cables: Cables,
    /// Busy loops beside the programs.
    pub hogs: u32,
    pub load: Load,
}

/// The result of one conversation.
#[derive(Default)]
pub struct Measured {
    pub received: Vec<Received>,
    /// Processor time of the proxies, bridges and switches, if there are any.
    pub cpu: Option<Duration>,
    /// Processor time of the machine, with both ends and the kernel.
    pub machine: Duration,
    pub wakeups: Option<u64>,
    pub system_calls: Option<u64>,
    /// Frames that the sending proxy sent again.
    pub repeated: Option<u64>,
}

pub struct Bench {
    tools: Tools,
    bridge: Option<PathBuf>,
}

impl Bench {
    /// Builds the programs of these routes, and removes namespaces of earlier runs.
    pub fn prepare(routes: &[BenchRoute], profile: Profile) -> Result<Self> {
        if !workspace::is_root() {
            bail!("network namespaces need root");
        }
        setup::ensure(Purpose::Bench)?;
        if routes.iter().any(|route| route.is_gdp()) {
            build::executables(Executables::All, profile, Features::default())?;
        }
        if routes.iter().any(|route| route.is_quinn()) {
            peer_programs::build_quic(profile)?;
        }
        peer_programs::build_dds()?;
        let zenoh = routes.iter().any(|route| route.is_zenoh());
        let bridge = zenoh.then(peer_programs::build_zenoh).transpose()?;
        wait::catch_interrupts();
        netns::sweep()?;
        Ok(Self { tools: workspace::tools(profile), bridge })
    }

    /// Sends `count` messages on a new network, and measures what arrives.
    pub fn measure(&self, route: BenchRoute, cables: &Cables, load: &Load, count: u64) -> Result<Measured> {
        let on_loopback = load.vendor == Vendor::Cyclone && route != BenchRoute::Ip;
        let Load { bytes: size, rate, topics, depth, vendor } = *load;
        let traffic = Traffic { count, rate, size, topics, depth, on_loopback, ..Default::default() };
        let folder = tempfile::Builder::new().prefix("gdp-bench-").tempdir()?;
        let folder = folder.path();
        if route == BenchRoute::Local {
            let host = Namespace::create("local")?;
            host.enable_loopback_multicast()?;
            return converse(&self.tools, vendor, [(&host, &traffic), (&host, &traffic)], &Between::default(), folder);
        }
        if route.is_gdp() {
            let options =
                FabricOptions { topics, udp: route == BenchRoute::GdpUdp, chain: cables.chain, ..Default::default() };
            let mut fabric = Fabric::start(self.tools.clone(), options)?;
            let wire = cables.disturb(&fabric.chain)?;
            fabric.start_proxies()?;
            let ends = [(fabric.chain.robot(), &traffic), (fabric.chain.cloud(), &traffic)];
            let between = Between {
                proxies: fabric.robot.iter().chain(&fabric.cloud).collect(),
                switches: fabric.switches.iter().map(|switch| &switch.process).collect(),
            };
            let measured = converse(&self.tools, vendor, ends, &between, folder)?;
            check(wire.as_ref());
            return Ok(Measured { repeated: Some(repeated(&fabric)), ..measured });
        }
        let chain = cables.routers()?;
        let wire = cables.disturb(&chain)?;
        let (robot, cloud) = chain.ip_ends();
        let to = |peer: &str| Traffic { peer: Some(peer.to_owned()), ..traffic.clone() };
        let run = |vendor, talks: &Traffic, hears: &Traffic, between: &Between<'_>| {
            let ends = [(chain.robot(), talks), (chain.cloud(), hears)];
            converse(&self.tools, vendor, ends, between, folder).inspect(|_| check(wire.as_ref()))
        };
        let over_tls = |vendor| {
            let tls = Some(secrets::make(&cloud, folder)?);
            let (talks, hears) = (Traffic { tls: tls.clone(), ..to(&cloud) }, Traffic { tls, ..traffic.clone() });
            run(vendor, &talks, &hears, &Between::default())
        };
        match route {
            BenchRoute::Tcp => run(Vendor::Tcp, &to(&cloud), &traffic, &Between::default()),
            BenchRoute::TcpTls => over_tls(Vendor::Tcp),
            BenchRoute::Quinn => over_tls(Vendor::Quic),
            BenchRoute::QuinnStreams => over_tls(Vendor::QuicStreams),
            // DDS finds its peers by multicast, which routers do not forward. So each side gets the
            // address of the other.
            BenchRoute::Ip => run(vendor, &to(&cloud), &to(&robot), &Between::default()),
            BenchRoute::Zenoh | BenchRoute::ZenohTls | BenchRoute::ZenohTlsLowLatency => {
                let Some(bridge) = &self.bridge else { bail!("the bridge was not built") };
                let security = match route {
                    BenchRoute::ZenohTls => Security::Tls,
                    BenchRoute::ZenohTlsLowLatency => Security::TlsLowLatency,
                    _ => Security::None,
                };
                let bridges = Bridges::start(bridge, &chain, security, folder)?;
                let between = Between { proxies: bridges.processes(), ..Between::default() };
                let node = |name: &str| Traffic { node: Some(name.into()), ..traffic.clone() };
                run(vendor, &node("talker"), &node("listener"), &between)
            }
            BenchRoute::Gdp | BenchRoute::GdpUdp | BenchRoute::Local => bail!("a path without routers"),
        }
    }
}

/// The programs between the two ends, whose processor time counts.
#[derive(Default)]
struct Between<'a> {
    /// Proxies or bridges, whose wake-ups and system calls count as well.
    proxies: Vec<&'a Process>,
    switches: Vec<&'a Process>,
}

/// Time of warm-up messages after the first one has arrived.
const SETTLE: Duration = Duration::from_millis(500);

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
    // What has waited for the listener arrives first, in portions.
    std::thread::sleep(SETTLE);
    let system_calls = SystemCalls::of(&between.proxies)?;
    let (before, woken, machine) = (between.cpu()?, between.wakeups()?, MachineTime::now()?);
    both.open()?;
    let sending = Duration::from_secs_f64(talks.count as f64 / talks.rate);
    let received = both.finish(sending, Duration::from_secs(10))?;
    let machine = machine.taken()?;
    let (taken, woken) = (between.cpu()?.saturating_sub(before), between.wakeups()?.saturating_sub(woken));
    let system_calls = system_calls.map(|calls| calls.read()).transpose()?;
    if between.proxies.is_empty() {
        return Ok(Measured { received, machine, ..Measured::default() });
    }
    Ok(Measured { received, cpu: Some(taken), machine, wakeups: Some(woken), system_calls, repeated: None })
}

impl Between<'_> {
    fn cpu(&self) -> Result<Duration> {
        self.proxies.iter().chain(&self.switches).map(|process| process.cpu()).sum()
    }

    fn wakeups(&self) -> Result<u64> {
        self.proxies.iter().map(|process| Ok(process.wakeups()?.values().sum::<u64>())).sum()
    }
}

/// Says if the cable with faults lost frames that it should have carried.
fn check(wire: Option<&Wire>) {
    if let Some(Err(error)) = wire.map(Wire::check) {
        eprintln!("not comparable: {error:#}");
    }
}

/// Returns the frames that the robot's proxy has sent again, by its statistics at its end.
fn repeated(fabric: &Fabric) -> u64 {
    let topics = fabric.proxy_stats("robot")["topics"].as_array().cloned().unwrap_or_default();
    topics.iter().filter_map(|topic| topic["fabric"]["repeated"].as_u64()).sum()
}

/// A busy loop, until it is dropped.
pub struct Hog(std::process::Child);

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
