//! The paths on which messages are measured, from one host to another, and the measurement of one
//! load on one path.
//!
//! ```text
//!  gdp      talker ─lo─ gdp-proxy ──── s1 ── s2 ── s3 ──── gdp-proxy ─lo─ listener     (XDP)
//!  gdp-udp  the same, with the frames in UDP over IPv4
//!  zenoh    talker ─lo─ zenoh-bridge ─ r1 ── r2 ── r3 ─ zenoh-bridge ─lo─ listener     (kernel IPv4)
//!  ip       talker ─────────────────── r1 ── r2 ── r3 ─────────────────── listener     (kernel IPv4)
//!  cable    talker ────────────────────────────────────────────────────── listener     (one network)
//!  local    talker ─lo─ listener                                                       (one host)
//!  gdp-nat  talker ─lo─ gdp-proxy ─ NAT ─ s1 ═ b1 ─ b3 ═ b2 ─ NAT ─ gdp-proxy ─lo─ listener
//!  tcp, tls, quinn: as ip, over a connection instead of DDS
//!  fast-dds: as ip, with Fast DDS at both ends; secured with DDS Security
//! ```
//!
//! In `gdp-nat`, `═` is the border of a trust domain ([`gdp_tests::federation`]). `ip`, `cable`,
//! `local`, `tcp`, `zenoh` and `fast-dds` are in clear, the others encrypted.

mod dds_security;
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
use gdp_tests::federation::Federation;
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
pub use self::zenoh::{Bridges, Security};
use crate::build::{self, Executables, Features};
use crate::peers as peer_programs;
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};

#[derive(Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum BenchRoute {
    Gdp,
    GdpUdp,
    /// Both ends behind NAT, in two trust domains below a third.
    GdpNat,
    Ip,
    /// Two hosts in one network.
    Cable,
    Local,
    /// Fast DDS at both ends, over routers.
    FastDds,
    /// The same, with DDS Security.
    FastDdsSecured,
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
        matches!(self, Self::Gdp | Self::GdpUdp | Self::GdpNat)
    }

    fn is_zenoh(self) -> bool {
        matches!(self, Self::Zenoh | Self::ZenohTls | Self::ZenohTlsLowLatency)
    }

    fn is_quinn(self) -> bool {
        matches!(self, Self::Quinn | Self::QuinnStreams)
    }

    /// Returns whether the path consists of [`Cables`]. Others have none, or their own network.
    pub fn has_cables(self) -> bool {
        !matches!(self, Self::Local | Self::GdpNat)
    }

    /// Returns the programs at both ends, for a load of this vendor.
    fn ends(self, of_load: Vendor) -> Vendor {
        match self {
            Self::Tcp | Self::TcpTls => Vendor::Tcp,
            Self::Quinn => Vendor::Quic,
            Self::QuinnStreams => Vendor::QuicStreams,
            Self::FastDds | Self::FastDdsSecured => Vendor::FastDds,
            _ => of_load,
        }
    }

    pub fn describe(self) -> &'static str {
        match self {
            Self::Gdp => "gdp: proxy, 3 XDP switches, proxy",
            Self::GdpUdp => "gdp: the same, over UDP",
            Self::GdpNat => "gdp: 2 NATs, 4 switches, 3 domains",
            Self::Ip => "ip: 3 kernel routers, in clear",
            Self::Cable => "cable: one network, in clear",
            Self::FastDds => "fast dds: 3 routers, in clear",
            Self::FastDdsSecured => "fast dds: 3 routers, DDS Security",
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
    /// node, and only the Cyclone program is one. The TCP programs and the federation have one
    /// topic.
    pub fn is_carried_by(&self, route: BenchRoute) -> bool {
        match route {
            BenchRoute::Tcp | BenchRoute::TcpTls => self.topics == 1 && self.vendor == Vendor::Cyclone,
            BenchRoute::GdpNat => self.topics == 1,
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

    pub fn disturb(&self, chain: &Chain) -> Result<Option<Wire>> {
        const SEED: u64 = 20;
        let Some(faults) = &self.faults else { return Ok(None) };
        chain.disturb_wire([faults.clone(), faults.clone()], SEED).map(Some)
    }

    pub fn routers(&self) -> Result<Chain> {
        let chain = Chain::build(self.chain)?;
        chain.become_ip_routers()?;
        for end in [chain.robot(), chain.cloud()] {
            end.enable_loopback_multicast()?;
        }
        Ok(chain)
    }

    /// Returns two hosts on one cable, over which DDS finds its peers by multicast.
    pub fn network(&self) -> Result<Chain> {
        let chain = Chain::build(ChainOptions { switches: 0, wire: self.chain.wire.map(|_| 0), ..self.chain })?;
        chain.become_ip_routers()?;
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
        // Bridges need a C++ toolchain, and certificates need openssl.
        let is_simple = |route: &BenchRoute| {
            route.is_gdp() || matches!(route, BenchRoute::Ip | BenchRoute::Cable | BenchRoute::Local)
        };
        setup::ensure(if routes.iter().all(is_simple) { Purpose::Demo } else { Purpose::Bench })?;
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

    /// Sends `count` messages on a new network, and measures what arrives. `cables` are those of
    /// the network, if [`BenchRoute::has_cables`].
    pub fn measure(&self, route: BenchRoute, cables: &Cables, load: &Load, count: u64) -> Result<Measured> {
        let Load { bytes: size, rate, topics, depth, vendor } = *load;
        let vendor = route.ends(vendor);
        let on_loopback = vendor == Vendor::Cyclone && !matches!(route, BenchRoute::Ip | BenchRoute::Cable);
        let traffic = Traffic { count, rate, size, topics, depth, on_loopback, ..Default::default() };
        let folder = tempfile::Builder::new().prefix("gdp-bench-").tempdir()?;
        let talk = Talk { tools: &self.tools, vendor, traffic: &traffic, folder: folder.path() };
        match route {
            BenchRoute::Local => {
                let host = Namespace::create("local")?;
                host.enable_loopback_multicast()?;
                talk.between([&host, &host], &Between::default())
            }
            BenchRoute::Cable => {
                let chain = cables.network()?;
                let wire = cables.disturb(&chain)?;
                talk.between([chain.robot(), chain.cloud()], &Between::default()).inspect(|_| check(wire.as_ref()))
            }
            BenchRoute::Gdp | BenchRoute::GdpUdp => self.over_fabric(route, cables, &talk),
            BenchRoute::GdpNat => self.over_federation(&talk),
            _ => self.over_routers(route, cables, &talk),
        }
    }

    fn over_fabric(&self, route: BenchRoute, cables: &Cables, talk: &Talk<'_>) -> Result<Measured> {
        let topics = talk.traffic.topics;
        let udp = route == BenchRoute::GdpUdp;
        let options = FabricOptions { topics, udp, chain: cables.chain, ..Default::default() };
        let mut fabric = Fabric::start(self.tools.clone(), options)?;
        let wire = cables.disturb(&fabric.chain)?;
        fabric.start_proxies()?;
        let between = Between {
            proxies: fabric.robot.iter().chain(&fabric.cloud).collect(),
            switches: fabric.switches.iter().map(|switch| &switch.process).collect(),
        };
        let measured = talk.between([fabric.chain.robot(), fabric.chain.cloud()], &between)?;
        check(wire.as_ref());
        Ok(Measured { repeated: Some(repeated(&fabric)), ..measured })
    }

    fn over_federation(&self, talk: &Talk<'_>) -> Result<Measured> {
        /// The switches from the robot to the cloud.
        const PATH: [&str; 4] = ["a1", "b1", "b3", "b2"];
        let mut federation = Federation::start(self.tools.clone())?;
        federation.start_proxies()?;
        let switches = PATH.iter().map(|label| Ok(&federation.switch(label)?.process)).collect::<Result<_>>()?;
        let proxies = federation.robot_proxy.iter().chain(&federation.cloud_proxy).collect();
        talk.between([&federation.robot, &federation.cloud], &Between { proxies, switches })
    }

    fn over_routers(&self, route: BenchRoute, cables: &Cables, talk: &Talk<'_>) -> Result<Measured> {
        let chain = cables.routers()?;
        let wire = cables.disturb(&chain)?;
        let (robot, cloud) = chain.ip_ends();
        let Talk { traffic, folder, .. } = *talk;
        let to = |peer: &str| Traffic { peer: Some(peer.to_owned()), ..traffic.clone() };
        let run = |talks: &Traffic, hears: &Traffic, between: &Between<'_>| {
            let ends = [(chain.robot(), talks), (chain.cloud(), hears)];
            talk.converse(ends, between).inspect(|_| check(wire.as_ref()))
        };
        match route {
            BenchRoute::Tcp => run(&to(&cloud), traffic, &Between::default()),
            BenchRoute::TcpTls | BenchRoute::Quinn | BenchRoute::QuinnStreams => {
                let tls = Some(secrets::make(&cloud, folder)?);
                let (talks, hears) = (Traffic { tls: tls.clone(), ..to(&cloud) }, Traffic { tls, ..traffic.clone() });
                run(&talks, &hears, &Between::default())
            }
            // DDS finds its peers by multicast, which routers do not forward. So each side gets the
            // address of the other.
            BenchRoute::Ip | BenchRoute::FastDds => run(&to(&cloud), &to(&robot), &Between::default()),
            BenchRoute::FastDdsSecured => {
                let [of_robot, of_cloud] = dds_security::make(folder)?;
                let talks = Traffic { security: Some(of_robot), ..to(&cloud) };
                let hears = Traffic { security: Some(of_cloud), ..to(&robot) };
                run(&talks, &hears, &Between::default())
            }
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
                run(&node("talker"), &node("listener"), &between)
            }
            BenchRoute::Gdp | BenchRoute::GdpUdp | BenchRoute::GdpNat | BenchRoute::Local | BenchRoute::Cable => {
                bail!("a path without routers")
            }
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

/// A conversation before its network is known.
struct Talk<'a> {
    tools: &'a Tools,
    vendor: Vendor,
    traffic: &'a Traffic,
    folder: &'a Path,
}

impl Talk<'_> {
    /// Runs the conversation with the same traffic at both ends.
    fn between(&self, [from, to]: [&Namespace; 2], between: &Between<'_>) -> Result<Measured> {
        self.converse([(from, self.traffic), (to, self.traffic)], between)
    }

    fn converse(
        &self,
        [(from, talks), (to, hears)]: [(&Namespace, &Traffic); 2],
        between: &Between<'_>,
    ) -> Result<Measured> {
        let Self { tools, vendor, folder, .. } = *self;
        let talker = Side { at: from, vendor, traffic: talks };
        let listener = Side { at: to, vendor, traffic: hears };
        let mut both = match Conversation::start(tools, talker, listener, folder) {
            Ok(both) => both,
            Err(error) => return nothing_arrives(&error),
        };
        // What has waited for the listener arrives first, in portions.
        std::thread::sleep(SETTLE);
        let system_calls = SystemCalls::of(&between.proxies)?;
        let (before, woken, machine) = (between.cpu()?, between.wakeups()?, MachineTime::now()?);
        both.open()?;
        let sending = Duration::from_secs_f64(talks.count as f64 / talks.rate);
        let received = match both.finish(sending, Duration::from_secs(10)) {
            Ok(received) => received,
            Err(error) => return nothing_arrives(&error),
        };
        let machine = machine.taken()?;
        let (taken, woken) = (between.cpu()?.saturating_sub(before), between.wakeups()?.saturating_sub(woken));
        let system_calls = system_calls.map(|calls| calls.read()).transpose()?;
        if between.proxies.is_empty() {
            return Ok(Measured { received, machine, ..Measured::default() });
        }
        Ok(Measured { received, cpu: Some(taken), machine, wakeups: Some(woken), system_calls, repeated: None })
    }
}

/// Reports a failure. It is also a row, so that a load that is too high for one path does not end
/// the benchmark.
fn nothing_arrives(error: &anyhow::Error) -> Result<Measured> {
    wait::check_interrupt()?;
    eprintln!("nothing arrives: {error:#}");
    Ok(Measured::default())
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
