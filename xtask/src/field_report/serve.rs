//! The edge: a switch with a RIB, a proxy, and the echo program twice.

use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use gdp_tests::Tools;
use gdp_tests::chain::GDP_PORT;
use gdp_tests::fabric::{Authority, Switch};
use gdp_tests::netns::Namespace;
use gdp_tests::process::Process;
use gdp_tests::topics::BothEnds;
use gdp_tests::wait::{self, Interrupted, TIMEOUT, wait_for};
use serde_json::{Value, json};

use super::echo::{self, EchoPath, PLAIN_PORTS, TOPICS};
use super::nic::{MachineFacts, Nic};
use super::robot_file::RobotFile;
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Interface that leads to the robot; XDP attaches to it, which may reset its link
    #[arg(long)]
    interface: String,
    /// IPv4 address of the interface, by which the robot reaches this machine
    #[arg(long)]
    address: Ipv4Addr,
}

pub fn run(options: &Options) -> Result<()> {
    let at = Namespace::here();
    if !workspace::is_root() {
        bail!("XDP needs root: run `sudo cargo xtask field-report serve …`");
    }
    let nic = Nic::find(&at, &options.interface)?;
    nic.check_address(options.address)?;
    let tools = echo::prepare(Profile::Dist)?;
    wait::catch_interrupts();
    let folder = echo::folder()?;
    let edge = Edge::start(&tools, &at, nic, &folder)?;
    let written = Written(folder.join("robot.json"));
    edge.robot_file()?.write(&written.0)?;
    println!("{}", edge.describe()?);
    println!(
        "\nCopy this file to the robot: {}\n\
         It contains a private key, which was made for this test only. Then run there:\n\n\
         \x20 cargo xtask field-report measure robot.json --to {}\n\n\
         A firewall has to let UDP ports {GDP_PORT} and {}-{} through. Ctrl-C ends the test.",
        written.0.display(),
        options.address,
        PLAIN_PORTS.start(),
        PLAIN_PORTS.end(),
    );
    match edge.watch() {
        Err(error) if error.is::<Interrupted>() => Ok(()),
        ended => ended,
    }
}

/// The robot's file, which is useless without this edge. Dropping it deletes it.
struct Written(PathBuf);

impl Drop for Written {
    fn drop(&mut self) {
        // The user may have moved it.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A running edge. Dropping it ends its programs and deletes their files.
pub struct Edge<'a> {
    tools: &'a Tools,
    at: &'a Namespace,
    nic: Nic,
    switch: Switch,
    /// The proxy and both echo programs.
    others: Vec<Process>,
    files: tempfile::TempDir,
}

/// Time in which the daemon takes its programs and its veth pair out of the kernel.
const STOP: Duration = Duration::from_secs(5);

/// Pause between looks at the programs.
const WATCH: Duration = Duration::from_secs(1);

impl<'a> Edge<'a> {
    /// Starts all programs in a new folder in `folder`, with keys made for this run.
    pub fn start(tools: &'a Tools, at: &'a Namespace, nic: Nic, folder: &Path) -> Result<Self> {
        let files = tempfile::Builder::new().prefix("edge-").tempdir_in(folder).context("cannot create a folder")?;
        let authority = Authority { tools, folder: files.path() };
        let name = authority.switch("s1")?;
        authority.owner()?;
        authority.proxy("robot")?;
        authority.proxy("cloud")?;
        let BothEnds { cloud: topics, .. } = authority.topics(&TOPICS, &[])?;
        let config = json!({
            "interfaces": [nic.name],
            "udp": format!("0.0.0.0:{GDP_PORT}"),
            "data_plane": "auto",
            "bpffs": null,
            "rib": true,
        });
        let switch = Switch::start(tools, at, files.path(), ("s1", &name), config)?;
        let mut edge = Self { tools, at, nic, switch, others: Vec::new(), files };
        wait_for("the switch", TIMEOUT, || {
            edge.switch.process.check_alive().context("the switch cannot run here; `gdp-ctl doctor` says more")?;
            // The daemon may not listen yet.
            Ok(edge.status().ok().map(drop))
        })?;
        let link = format!("udp://127.0.0.1:{GDP_PORT}");
        edge.others.push(echo::start_proxy(tools, at, edge.files.path(), "cloud", &link, topics)?);
        for path in [EchoPath::Plain { interface: &edge.nic.name, peer: None }, EchoPath::Gdp] {
            let label = format!("edge-{}", path.name());
            let program = Process::spawn(&label, path.program(at, "edge.py")?, edge.files.path())?;
            edge.others.push(program);
        }
        edge.others.iter_mut().skip(1).try_for_each(|program| program.wait_event("ready", TIMEOUT).map(drop))?;
        Ok(edge)
    }

    /// Returns what the robot needs.
    pub fn robot_file(&self) -> Result<RobotFile> {
        let facts = MachineFacts::of(self.at, &self.nic)?;
        let plane = self.interface()?["data_plane"].as_str().unwrap_or("unknown").to_owned();
        RobotFile::collect(&self.files.path().join("robot"), &self.switch.name, facts, &plane)
    }

    /// Says what forwards at the interface, and why.
    fn describe(&self) -> Result<String> {
        let interface = self.interface()?;
        let text = |key: &str| interface[key].as_str().unwrap_or("unknown").to_owned();
        Ok(format!("data plane of {}: {} ({})", self.nic.name, text("data_plane"), text("reason")))
    }

    /// Returns the interface's part of the switch's status.
    fn interface(&self) -> Result<Value> {
        let status = self.status()?;
        let interfaces = status["interfaces"].as_array().into_iter().flatten();
        let found = interfaces.into_iter().find(|it| it["interface"] == *self.nic.name);
        found.cloned().with_context(|| format!("the switch does not use `{}`", self.nic.name))
    }

    fn status(&self) -> Result<Value> {
        self.switch.ctl(self.tools, &["status"])
    }

    /// Waits for Ctrl-C, or until a program ends.
    fn watch(mut self) -> Result<()> {
        loop {
            wait::sleep(WATCH)?;
            self.switch.process.check_alive()?;
            self.others.iter_mut().try_for_each(Process::check_alive)?;
        }
    }

    /// Returns the end of every program's output, for a failure message.
    pub fn report(&self) -> String {
        let all = [&self.switch.process].into_iter().chain(&self.others);
        all.map(Process::report).collect::<Vec<_>>().join("\n")
    }
}

impl Drop for Edge<'_> {
    fn drop(&mut self) {
        self.others.clear();
        // A killed daemon would leave the veth pair of the proxy on the user's machine.
        let _ = self.switch.process.stop(STOP);
    }
}
