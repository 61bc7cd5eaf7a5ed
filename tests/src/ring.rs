//! Five switches in a ring, as on the paper's testbed, each with a daemon; a robot at the first, a
//! cloud at the third, the RIB at the fifth:
//!
//! ```text
//!  robot r0 ── e0 s1 r0 ──── l0 s2 r0 ──── l0 s3 e0 ── l0 cloud
//!                  l0                           r0
//!                   │                           │
//!                  r0 s5 l0 ──────────── r0 s4 l0
//!                     RIB
//! ```
//!
//! The way from robot to cloud is by s2; if that is cut, by s5 and s4. s3 asks the RIB by s4; if
//! that is cut, or s4's daemon dead, by s2 and s1. No switch is told where the RIB is.

use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::fabric::{Authority, Mounted, Switch};
use crate::netns::{End, Namespace, veth};
use crate::tools::Tools;
use crate::wait::{TIMEOUT, wait_for};

const SWITCHES: usize = 5;

/// Names that each switch has room for: benchmarks have a million, and a few.
const FIB_CAPACITY: u32 = 1 << 21;

/// Where the robot, the cloud and the RIB are; counted from 0.
pub const ROBOT_AT: usize = 0;
pub const CLOUD_AT: usize = 2;
pub const RIB_AT: usize = 4;

/// A running ring. Dropping it ends the daemons, then removes the namespaces and files.
pub struct Ring {
    // Order is the order of the end: daemons, network, file systems, files.
    pub switches: Vec<Switch>,
    nodes: Vec<Namespace>,
    pub robot: Namespace,
    pub cloud: Namespace,
    tools: Tools,
    bpffs: Mounted,
    files: tempfile::TempDir,
}

impl Ring {
    /// Network, keys and daemons; every switch knows the shortest path to every other. The owner of
    /// a topic has admitted the robot as its publisher and the cloud as a reader.
    pub fn start(tools: Tools) -> Result<Self> {
        let nodes: Vec<_> = (1..=SWITCHES).map(|i| Namespace::create(&format!("s{i}"))).collect::<Result<Vec<_>>>()?;
        let (robot, cloud) = (Namespace::create("robot")?, Namespace::create("cloud")?);
        let cables = (0..SWITCHES).map(|i| ((&nodes[i], "r0"), (&nodes[(i + 1) % SWITCHES], "l0")));
        let ends = [((&robot, "r0"), (&nodes[ROBOT_AT], "e0")), ((&nodes[CLOUD_AT], "e0"), (&cloud, "l0"))];
        for (i, (a, b)) in cables.chain(ends).enumerate() {
            let end = |(namespace, interface), side| End { namespace, interface, mac: [2, 0, 0, 0, i as u8, side] };
            veth(&end(a, 1), &end(b, 2), 1500)?;
        }
        let files = tempfile::Builder::new().prefix("gdp-ring-").tempdir().context("cannot create a folder")?;
        let authority = Authority { tools: &tools, folder: files.path() };
        let names = authority.switches(SWITCHES)?;
        authority.topic()?;
        authority.admit("robot", "--publish")?;
        authority.admit("cloud", "--read")?;
        let bpffs = Mounted(files.path().join("bpf"));
        let start = |i: usize| {
            let label = format!("s{}", i + 1);
            Switch::start(&tools, &nodes[i], files.path(), (&label, &names[i]), config(i, &names, &bpffs))
        };
        let switches = (0..SWITCHES).map(start).collect::<Result<Vec<_>>>()?;
        let mut ring = Self { switches, nodes, robot, cloud, tools, bpffs, files };
        for i in 0..SWITCHES {
            ring.wait(&format!("s{} to know the shortest paths", i + 1), |ring| {
                let topology = ring.ctl(i, &["topology"])?;
                let ways = topology["switches"].as_array().into_iter().flatten();
                // Round the other side it is three.
                let is_shortest = |switch: &&Value| switch["cost"].as_u64().is_some_and(|cost| cost <= 2);
                let known = ways.filter(|switch| switch["next"].is_string()).filter(is_shortest);
                Ok(known.count() == SWITCHES - 1)
            })?;
        }
        Ok(ring)
    }

    /// A `gdp-ctl` command against the daemon of switch `i`, as JSON.
    pub fn ctl(&self, i: usize, arguments: &[&str]) -> Result<Value> {
        self.switches[i].ctl(&self.tools, arguments)
    }

    /// Another daemon for switch `i`, which has none any more.
    pub fn start_again(&mut self, i: usize) -> Result<()> {
        let names: Vec<String> = self.switches.iter().map(|switch| switch.name.clone()).collect();
        let (label, config) = (format!("s{}", i + 1), config(i, &names, &self.bpffs));
        let who = (label.as_str(), names[i].as_str());
        self.switches[i] = Switch::start(&self.tools, &self.nodes[i], self.files.path(), who, config)?;
        Ok(())
    }

    /// Waits until switch `i` asks the RIB, by way of switch `next`.
    pub fn wait_for_way(&mut self, i: usize, next: usize) -> Result<()> {
        self.wait(&format!("s{} to ask the RIB by s{}", i + 1, next + 1), |ring| {
            let control = ring.ctl(i, &["status"])?["control"].clone();
            Ok(control["ready"] == true && control["next"] == *ring.switches[next].name)
        })
    }

    /// Data frames that switch `i` has sent on without its daemon.
    pub fn forwarded(&self, i: usize) -> Result<u64> {
        let status = self.ctl(i, &["status"])?;
        Ok(status["counters_by_plane"]["forwarded"]["kernel"].as_u64().unwrap_or(0))
    }

    /// What the RIB has told switch `i`, as a number that counts up with it.
    pub fn generation(&self, i: usize) -> Result<u64> {
        self.ctl(i, &["status"])?["fib"]["generation"].as_u64().context("no generation in the status")
    }

    /// Pulls the cable between switch `i` and the next, or puts it in again.
    pub fn set_cable(&self, i: usize, plugged: bool) -> Result<()> {
        let state = if plugged { "up" } else { "down" };
        self.nodes[i].ip(&["link", "set", "r0", state]).map(drop)
    }

    /// Waits until a condition holds; errors, as of a daemon that does not answer yet, count as no.
    pub fn wait(&mut self, what: &str, condition: impl Fn(&Self) -> Result<bool>) -> Result<()> {
        wait_for(what, TIMEOUT, || Ok(condition(self).unwrap_or(false).then_some(()))).with_context(|| self.report())
    }

    /// All that `robot` or `cloud` has.
    pub fn folder_of(&self, party: &str) -> PathBuf {
        self.files.path().join(party)
    }

    /// The end of every daemon's output, for a failure message.
    pub fn report(&self) -> String {
        self.switches.iter().map(|switch| switch.process.report()).collect::<Vec<_>>().join("\n")
    }
}

fn config(i: usize, names: &[String], bpffs: &Mounted) -> Value {
    let (before, after) = ((i + SWITCHES - 1) % SWITCHES, (i + 1) % SWITCHES);
    let left = json!({"interface": "l0", "switch": names[before], "cost": 1});
    let right = json!({"interface": "r0", "switch": names[after], "cost": 1});
    let has_endpoint = i == ROBOT_AT || i == CLOUD_AT;
    let interfaces = if has_endpoint { vec!["l0", "r0", "e0"] } else { vec!["l0", "r0"] };
    json!({
        "interfaces": interfaces,
        "udp": null,
        "data_plane": "xdp",
        "bpffs": bpffs.0,
        "fib_capacity": FIB_CAPACITY,
        "rib": i == RIB_AT,
        "neighbours": [left, right],
    })
}
