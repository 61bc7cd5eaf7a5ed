//! The robot, the edge, and what is between them, for each setup of the evaluation.
//!
//! The robot's programs stay on one processor, and those of the edge on another. Switches and
//! routers run wherever the kernel puts them.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use gdp_tests::chain::Chain;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::federation::Federation;
use gdp_tests::measure::cpu;
use gdp_tests::netns::Namespace;
use gdp_tests::peers::ON_LOOPBACK;
use gdp_tests::process::Process;
use gdp_tests::ring::Ring;
use gdp_tests::topics::FabricTopic;
use gdp_tests::wire::Wire;
use serde::Serialize;
use serde_json::Value;

use super::quota::Quota;
use super::tools::EvalTools;
use crate::bench::paths::{Bridges, Cables, Security};

/// The ends of a site, as indices.
const ROBOT: usize = 0;
const EDGE: usize = 1;

/// Labels of the programs at the ends, and their processors.
const LABELS: [&str; 2] = ["robot", "edge"];
const CPUS: [usize; 2] = [cpu::SENDER, cpu::OTHER];

/// The share of a processor that the robot has where it works alone. Two cores of 1.5 GHz, as in
/// the paper's robot, stand to the edge's cores of 3 GHz as a half to one. The workloads keep
/// little more than one core busy, so the number of cores is left out.
const ROBOT_SHARE: f64 = 0.5;

#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Setup {
    /// Both programs on the robot, which has half of a processor
    RobotOnly,
    /// DDS over one cable
    Cable,
    /// DDS over three kernel routers
    Routers,
    /// Two zenoh bridges with TLS over the same routers
    Zenoh,
    /// Two proxies and three XDP switches, over Ethernet
    Gdp,
    /// Two proxies behind NAT in two trust domains, with the border of a third between them
    Domains,
}

impl Setup {
    pub fn describe(self) -> &'static str {
        match self {
            Self::RobotOnly => "robot only",
            Self::Cable => "ROS 2, one network",
            Self::Routers => "ROS 2, 3 routers",
            Self::Zenoh => "zenoh bridges, TLS",
            Self::Gdp => "GDP, 3 XDP switches",
            Self::Domains => "GDP, NAT, 2 domains",
        }
    }

    /// Returns whether the cable with faults can be in its network.
    pub fn has_wire(self) -> bool {
        matches!(self, Self::Routers | Self::Zenoh | Self::Gdp)
    }
}

/// The network of a setup, with all that runs between robot and edge.
pub struct Site {
    // Fields drop in this order: bridges and proxies, faults, network, group.
    bridges: Option<Bridges>,
    proxies: Option<[Process; 2]>,
    wire: Option<Wire>,
    pub network: Network,
    quota: Option<Quota>,
}

/// Namespaces, and the switches in them.
pub enum Network {
    Host(Namespace),
    Chain(Chain),
    Fabric(Fabric),
    Federation(Federation),
    Ring(Ring),
}

impl Site {
    /// Starts everything but the workload. `folder` receives the bridges' files.
    pub fn start(
        tools: &EvalTools,
        setup: Setup,
        cables: &Cables,
        topics: &[FabricTopic],
        folder: &Path,
    ) -> Result<Self> {
        let site = |network| Self { bridges: None, proxies: None, wire: None, network, quota: None };
        let this = match setup {
            Setup::RobotOnly => {
                let host = Namespace::create("robot")?;
                host.enable_loopback_multicast()?;
                Self { quota: Some(Quota::new(ROBOT_SHARE)?), ..site(Network::Host(host)) }
            }
            Setup::Cable => site(Network::Chain(cables.network()?)),
            Setup::Routers | Setup::Zenoh => {
                let chain = cables.routers()?;
                let wire = cables.disturb(&chain)?;
                let bridges = (setup == Setup::Zenoh).then(|| {
                    let program = tools.bridge.as_deref().context("the bridge was not built")?;
                    Bridges::start(program, &chain, Security::Tls, folder)
                });
                let bridges = bridges.transpose()?;
                Self { bridges, wire, ..site(Network::Chain(chain)) }
            }
            Setup::Gdp => {
                let options = FabricOptions { chain: cables.chain, ..Default::default() };
                let mut fabric = Fabric::start(tools.tools.clone(), options)?;
                fabric.start_proxies_of(topics)?;
                let wire = cables.disturb(&fabric.chain)?;
                Self { wire, ..site(Network::Fabric(fabric)) }
            }
            Setup::Domains => {
                let mut federation = Federation::start(tools.tools.clone())?;
                federation.start_proxies_of(topics)?;
                site(Network::Federation(federation))
            }
        };
        this.pinned()
    }

    /// Starts five switches in a ring.
    pub fn ring(tools: &EvalTools, topics: &[FabricTopic]) -> Result<Self> {
        let ring = Ring::start(tools.tools.clone())?;
        let proxies = Some(ring.start_proxies_of(topics)?);
        Self { bridges: None, proxies, wire: None, network: Network::Ring(ring), quota: None }.pinned()
    }

    /// Keeps the proxies or bridges of robot and edge on their processors.
    fn pinned(self) -> Result<Self> {
        for (cpu, process) in CPUS.into_iter().zip(self.between()) {
            if let Some(process) = process {
                cpu::keep_program(cpu, process.pid())?;
            }
        }
        Ok(self)
    }

    /// Returns the proxy or bridge of the robot, and that of the edge.
    fn between(&self) -> [Option<&Process>; 2] {
        match (&self.network, &self.bridges, &self.proxies) {
            (_, Some(bridges), _) => bridges.ends().map(Some),
            (_, _, Some(proxies)) => proxies.each_ref().map(Some),
            (Network::Fabric(fabric), ..) => [fabric.robot.as_ref(), fabric.cloud.as_ref()],
            (Network::Federation(it), ..) => [it.robot_proxy.as_ref(), it.cloud_proxy.as_ref()],
            _ => [None, None],
        }
    }

    /// Starts the edge's program.
    pub fn start_edge(&self, command: impl FnOnce(&Namespace) -> Result<Command>, folder: &Path) -> Result<Process> {
        self.start_program(EDGE, command, folder)
    }

    /// Starts the robot's program.
    pub fn start_robot(&self, command: impl FnOnce(&Namespace) -> Result<Command>, folder: &Path) -> Result<Process> {
        self.start_program(ROBOT, command, folder)
    }

    fn start_program(
        &self,
        end: usize,
        command: impl FnOnce(&Namespace) -> Result<Command>,
        folder: &Path,
    ) -> Result<Process> {
        let mut command = command(self.ends()[end])?;
        let peer = self.peers()[end].as_deref().map(unicast);
        command.env("CYCLONEDDS_URI", peer.unwrap_or_else(|| ON_LOOPBACK.to_owned()));
        let process = Process::spawn(LABELS[end], command, folder)?;
        if let Some(quota) = &self.quota {
            quota.add(&process)?;
        }
        // Alone, the robot runs both programs.
        let computer = if self.is_robot_only() { ROBOT } else { end };
        cpu::keep_program(CPUS[computer], process.pid())?;
        Ok(process)
    }

    /// Returns the namespaces of robot and edge.
    pub fn ends(&self) -> [&Namespace; 2] {
        match &self.network {
            Network::Host(host) => [host, host],
            Network::Chain(chain) => [chain.robot(), chain.cloud()],
            Network::Fabric(fabric) => [fabric.chain.robot(), fabric.chain.cloud()],
            Network::Federation(it) => [&it.robot, &it.cloud],
            Network::Ring(ring) => [&ring.robot, &ring.cloud],
        }
    }

    /// Returns the DDS peer of the robot, and that of the edge. Without a peer, DDS is on `lo`
    /// alone.
    fn peers(&self) -> [Option<String>; 2] {
        match (&self.network, &self.bridges) {
            (Network::Chain(chain), None) => {
                let (robot, edge) = chain.ip_ends();
                [Some(edge), Some(robot)]
            }
            _ => [None, None],
        }
    }

    /// Returns the robot's proxy or bridge.
    pub fn robot_proxy(&self) -> Option<&Process> {
        self.between()[ROBOT]
    }

    /// Returns the latest statistics of the robot's proxy and of the edge's, if there are proxies.
    pub fn proxy_stats(&self) -> Option<[Value; 2]> {
        let folders = ["robot", "cloud"].map(|label| match &self.network {
            Network::Fabric(fabric) => Some(fabric.folder_of(label)),
            Network::Federation(federation) => Some(federation.folder_of(label)),
            Network::Ring(ring) => Some(ring.folder_of(label)),
            Network::Host(_) | Network::Chain(_) => None,
        });
        let read = |folder: PathBuf| {
            let text = std::fs::read_to_string(folder.join("stats.json")).unwrap_or_default();
            serde_json::from_str(&text).unwrap_or_default()
        };
        let [robot, edge] = folders;
        Some([read(robot?), read(edge?)])
    }

    /// Returns whether the cable with faults carried all frames that it should have, and says why
    /// not.
    pub fn check_wire(&self) -> bool {
        let checked = self.wire.as_ref().map_or(Ok(()), Wire::check);
        checked.inspect_err(|error| eprintln!("not comparable: {error:#}")).is_ok()
    }

    /// Returns whether the edge's program is on the robot as well.
    pub fn is_robot_only(&self) -> bool {
        matches!(self.network, Network::Host(_))
    }

    /// Returns the bytes that have left and entered the robot by its uplink.
    pub fn uplink_bytes(&self) -> Result<u64> {
        if self.is_robot_only() {
            return Ok(0);
        }
        let _inside = self.ends()[ROBOT].enter()?;
        let text = std::fs::read_to_string("/proc/thread-self/net/dev").context("cannot read the interfaces")?;
        Ok(text.lines().filter_map(interface_bytes).sum())
    }
}

/// Parses a line of `/proc/net/dev`: the bytes received and sent, unless it is of `lo`.
fn interface_bytes(line: &str) -> Option<u64> {
    let (name, counters) = line.split_once(':')?;
    let counters: Vec<u64> = counters.split_ascii_whitespace().filter_map(|number| number.parse().ok()).collect();
    (name.trim() != "lo").then(|| Some(counters.first()? + counters.get(8)?)).flatten()
}

/// Returns the configuration of Cyclone DDS that discovers this address, and nothing by multicast.
fn unicast(peer: &str) -> String {
    format!(
        "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>\
         <ParticipantIndex>auto</ParticipantIndex><Peers><Peer address=\"{peer}\"/></Peers></Discovery></Domain>\
         </CycloneDDS>"
    )
}

#[cfg(test)]
#[path = "../../tests/unit/site.rs"]
mod tests;
