//! Starts two zenoh bridges, one at each end of a chain of routers, for comparison.

use std::fs;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use gdp_tests::chain::Chain;
use gdp_tests::netns::Namespace;
use gdp_tests::peers::{ON_LOOPBACK, Tls};
use gdp_tests::process::Process;
use serde_json::{Value, json};

use super::secrets;

/// The port of zenoh's routers.
const PORT: u16 = 7447;

const TIMEOUT: Duration = Duration::from_secs(20);

pub struct Bridges([Process; 2]);

/// How bridges are connected. With TLS, each presents a certificate, as both ends of a link in the
/// fabric do.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Security {
    None,
    Tls,
    /// Zenoh's transport for low latency, and express publications, which are never batched.
    TlsLowLatency,
}

impl Bridges {
    /// Starts both bridges. The cloud's bridge listens, and the robot's connects.
    pub fn start(program: &Path, chain: &Chain, security: Security, folder: &Path) -> Result<Self> {
        let (_, cloud) = chain.ip_ends();
        let (protocol, secrets) = match security {
            Security::None => ("tcp", None),
            Security::Tls | Security::TlsLowLatency => ("tls", Some(secrets::make(&cloud, folder)?)),
        };
        let low_latency = security == Security::TlsLowLatency;
        let endpoint = |host: &str| json!({"endpoints": [format!("{protocol}/{host}:{PORT}")]});
        let listens = json!({"listen": endpoint("0.0.0.0")});
        // A router listens by default.
        let dials = json!({"connect": endpoint(&cloud), "listen": {"endpoints": []}});
        let start = |label, at, role| start(program, label, at, config(role, secrets.as_ref(), low_latency), folder);
        let listening = start("bridge-cloud", chain.cloud(), listens)?;
        Ok(Self([listening, start("bridge-robot", chain.robot(), dials)?]))
    }

    pub fn processes(&self) -> Vec<&Process> {
        self.0.iter().collect()
    }

    /// Returns the bridge of the robot, and that of the cloud.
    pub fn ends(&self) -> [&Process; 2] {
        let [cloud, robot] = &self.0;
        [robot, cloud]
    }
}

fn config(mut config: Value, secrets: Option<&Tls>, low_latency: bool) -> Value {
    config["mode"] = "router".into();
    config["scouting"] = json!({"multicast": {"enabled": false}});
    config["plugins"] = json!({"ros2dds": {"domain": 0, "__required__": true}});
    if let Some(Tls { key, certificate }) = secrets {
        config["transport"] = json!({"link": {"tls": {
            "root_ca_certificate": certificate, "enable_mtls": true,
            "listen_private_key": key, "listen_certificate": certificate,
            "connect_private_key": key, "connect_certificate": certificate,
        }}});
    }
    if low_latency {
        config["transport"]["unicast"] = json!({"lowlatency": true, "qos": {"enabled": false}});
        config["qos"] = json!({"publication": [{"key_exprs": ["**"], "config": {"express": true}}]});
    }
    config
}

fn start(program: &Path, label: &str, at: &Namespace, config: Value, folder: &Path) -> Result<Process> {
    let file = folder.join(format!("{label}.json5"));
    fs::write(&file, config.to_string()).with_context(|| format!("cannot write {}", file.display()))?;
    let mut command = at.command(program)?;
    command.arg(file).env("CYCLONEDDS_URI", ON_LOOPBACK).env("ROS_DISTRO", "jazzy");
    let mut process = Process::spawn(label, command, folder)?;
    process.wait_event("ready", TIMEOUT)?;
    Ok(process)
}
