//! Starts two zenoh bridges, one at each end of a chain of routers, for comparison.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use gdp_tests::chain::Chain;
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::peers::ON_LOOPBACK;
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program};
use serde_json::{Value, json};

/// The port of zenoh's routers.
const PORT: u16 = 7447;

const TIMEOUT: Duration = Duration::from_secs(20);

pub struct Bridges([Process; 2]);

impl Bridges {
    /// Starts both bridges. The cloud's bridge listens, and the robot's connects. With `tls`, each
    /// presents a certificate, as both ends of a link in the fabric do.
    pub fn start(program: &Path, chain: &Chain, tls: bool, folder: &Path) -> Result<Self> {
        let (_, cloud) = chain.ip_ends();
        let (protocol, secrets) = if tls { ("tls", Some(Secrets::make(&cloud, folder)?)) } else { ("tcp", None) };
        let endpoint = |host: &str| json!({"endpoints": [format!("{protocol}/{host}:{PORT}")]});
        let listens = json!({"listen": endpoint("0.0.0.0")});
        // A router listens by default.
        let dials = json!({"connect": endpoint(&cloud), "listen": {"endpoints": []}});
        let start = |label, at, role| start(program, label, at, config(role, secrets.as_ref()), folder);
        let listening = start("bridge-cloud", chain.cloud(), listens)?;
        Ok(Self([listening, start("bridge-robot", chain.robot(), dials)?]))
    }

    pub fn processes(&self) -> Vec<&Process> {
        self.0.iter().collect()
    }
}

/// A key and its certificate, which both ends use and trust.
struct Secrets {
    key: PathBuf,
    certificate: PathBuf,
}

impl Secrets {
    fn make(host: &str, folder: &Path) -> Result<Self> {
        let (key, certificate) = (folder.join("bridge.key"), folder.join("bridge.crt"));
        let mut command = Program::Openssl.command();
        command.args([
            "req",
            "-x509",
            "-newkey",
            "ec",
            "-pkeyopt",
            "ec_paramgen_curve:prime256v1",
            "-nodes",
            "-days",
            "2",
        ]);
        command.args(["-subj", "/CN=bridge", "-addext", &format!("subjectAltName=IP:{host}")]);
        // The self-signed certificate is its own authority. It must not be a CA certificate,
        // because TLS would not accept that for an endpoint.
        command.args(["-addext", "basicConstraints=critical,CA:FALSE"]);
        command.arg("-keyout").arg(&key).arg("-out").arg(&certificate);
        execute(&mut command)?;
        Ok(Self { key, certificate })
    }
}

fn config(mut config: Value, secrets: Option<&Secrets>) -> Value {
    config["mode"] = "router".into();
    config["scouting"] = json!({"multicast": {"enabled": false}});
    config["plugins"] = json!({"ros2dds": {"domain": 0, "__required__": true}});
    if let Some(Secrets { key, certificate }) = secrets {
        config["transport"] = json!({"link": {"tls": {
            "root_ca_certificate": certificate, "enable_mtls": true,
            "listen_private_key": key, "listen_certificate": certificate,
            "connect_private_key": key, "connect_certificate": certificate,
        }}});
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
