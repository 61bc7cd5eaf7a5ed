//! The `echo` workload at both ends: its topics, its programs, and their DDS domains.
//!
//! Plain DDS is on one interface without multicast, and the ROS side of GDP is on `lo` alone. Each
//! has a domain of its own, so that neither meets the other or the user's own nodes.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use gdp_tests::Tools;
use gdp_tests::netns::Namespace;
use gdp_tests::peers::ON_LOOPBACK;
use gdp_tests::process::Process;
use gdp_tests::topics::{FabricTopic, ProxyPlan};
use serde_json::{Value, json};

use crate::build::{self, Executables, Features};
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};

pub const TOPICS: [FabricTopic; 2] = [topic("/echo/request", true), topic("/echo/reply", false)];

const fn topic(topic: &'static str, from_robot: bool) -> FabricTopic {
    FabricTopic { topic, kind: "sensor_msgs/msg/Image", from_robot, in_ros1: false }
}

/// DDS domains. Their ports are 250 apart and begin at 7400.
const GDP_DOMAIN: u16 = 61;
const PLAIN_DOMAIN: u16 = 62;

/// The UDP ports of plain DDS, for people with a firewall.
pub const PLAIN_PORTS: std::ops::RangeInclusive<u16> = 7400 + 250 * PLAIN_DOMAIN..=7649 + 250 * PLAIN_DOMAIN;

/// Installs and builds what is missing.
pub fn prepare(profile: Profile) -> Result<Tools> {
    setup::ensure(Purpose::FieldReport)?;
    build::executables(Executables::All, profile, Features::default())?;
    Ok(workspace::tools(profile))
}

/// Returns the folder of what this verb writes, and creates it.
pub fn folder() -> Result<PathBuf> {
    let folder = workspace::target().join("field-report");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    Ok(folder)
}

/// The network between the two programs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EchoPath<'a> {
    /// DDS on this interface. The robot knows the edge's address.
    Plain { interface: &'a str, peer: Option<std::net::Ipv4Addr> },
    /// DDS on `lo`, behind a proxy.
    Gdp,
}

impl EchoPath<'_> {
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain { .. } => "dds",
            Self::Gdp => "gdp",
        }
    }

    /// Returns the command of `edge.py` or `robot.py`.
    pub fn program(self, at: &Namespace, file: &str) -> Result<Command> {
        let mut command = at.command(workspace::target().join(setup::EVAL_ENVIRONMENT).join("bin/python"))?;
        command.arg(workspace::root().join("eval").join(file)).arg("echo");
        let (domain, configuration) = match self {
            Self::Plain { interface, peer } => (PLAIN_DOMAIN, unicast(interface, peer)),
            Self::Gdp => (GDP_DOMAIN, ON_LOOPBACK.to_owned()),
        };
        command.env("ROS_DOMAIN_ID", domain.to_string()).env("CYCLONEDDS_URI", configuration);
        Ok(command)
    }
}

/// Returns the configuration of Cyclone DDS on one interface without multicast.
fn unicast(interface: &str, peer: Option<std::net::Ipv4Addr>) -> String {
    let peers = peer.map_or_else(String::new, |peer| format!("<Peers><Peer address=\"{peer}\"/></Peers>"));
    format!(
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"{interface}\"/></Interfaces>\
         <AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>{peers}\
         </Discovery></Domain></CycloneDDS>"
    )
}

/// Starts a proxy whose files are in the folder of its label. It sees no nodes of other machines,
/// nor the programs of plain DDS.
pub fn start_proxy(
    tools: &Tools,
    at: &Namespace,
    files: &Path,
    label: &str,
    link: &str,
    topics: Vec<Value>,
) -> Result<Process> {
    let graphs = json!({"ros2": {"domain_id": GDP_DOMAIN}});
    let mut command = ProxyPlan { links: vec![link], graphs, topics, peers: None }.command(tools, at, files, label)?;
    command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST").env_remove("ROS_LOCALHOST_ONLY");
    Process::spawn(&format!("{label}-proxy"), command, files)
}
