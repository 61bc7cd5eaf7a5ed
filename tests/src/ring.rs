//! Five switches in a ring, as on the paper's testbed, each with a daemon. The robot is at the
//! first, the cloud at the third, the RIB at the fifth:
//!
//! ```text
//!  robot r0 ── e0 s1 r0 ──── l0 s2 r0 ──── l0 s3 e0 ── l0 cloud
//!                  l0                           r0
//!                   │                           │
//!                  r0 s5 l0 ──────────── r0 s4 l0
//!                     RIB
//! ```
//!
//! The cable from s1 to s2 may have a bridge in its middle, which can block it without a trace at
//! its ends.
//!
//! The path from robot to cloud crosses s2; after a cut, s5 and s4. s3 reaches the RIB through s4;
//! after a cut, or without s4's daemon, through s2 and s1. No configuration says where the RIB is.

use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::bridge::BridgedCable;
use crate::fabric::{Authority, Mounted, Switch};
use crate::netns::{End, Namespace, veth};
use crate::process::Process;
use crate::tools::Tools;
use crate::topics::{BothEnds, FabricTopic, ProxyPlan, ros2};
use crate::wait::{TIMEOUT, wait_for};

pub const SWITCHES: usize = 5;

/// FIB capacity of each switch, in names: benchmarks use a million, and a few more.
const FIB_CAPACITY: u32 = 1 << 21;

/// Indices of the switches of the robot, the cloud and the RIB; from 0.
pub const ROBOT_AT: usize = 0;
pub const CLOUD_AT: usize = 2;
pub const RIB_AT: usize = 4;

/// A running ring. Dropping it ends the daemons, then deletes the namespaces and files.
pub struct Ring {
    // Fields drop in this order: daemons, network, file systems, files.
    pub switches: Vec<Switch>,
    nodes: Vec<Namespace>,
    pub robot: Namespace,
    pub cloud: Namespace,
    wire: Option<BridgedCable>,
    tools: Tools,
    bpffs: Mounted,
    files: tempfile::TempDir,
}

impl Ring {
    /// Starts network, keys and daemons. Every switch knows the shortest path to every other. The
    /// owner of a topic has admitted the robot as its publisher and the cloud as a reader.
    pub fn start(tools: Tools) -> Result<Self> {
        Self::build(tools, false)
    }

    /// Starts the ring as [`Self::start`] does, with a bridge between s1 and s2.
    pub fn start_with_wire(tools: Tools) -> Result<Self> {
        Self::build(tools, true)
    }

    fn build(tools: Tools, has_wire: bool) -> Result<Self> {
        let nodes: Vec<_> = (1..=SWITCHES).map(|i| Namespace::create(&format!("s{i}"))).collect::<Result<Vec<_>>>()?;
        let (robot, cloud) = (Namespace::create("robot")?, Namespace::create("cloud")?);
        let cables = (0..SWITCHES).map(|i| ((&nodes[i], "r0"), (&nodes[(i + 1) % SWITCHES], "l0")));
        let ends = [((&robot, "r0"), (&nodes[ROBOT_AT], "e0")), ((&nodes[CLOUD_AT], "e0"), (&cloud, "l0"))];
        let mut wire = None;
        for (i, (a, b)) in cables.chain(ends).enumerate() {
            let end = |(namespace, interface), side| End { namespace, interface, mac: [2, 0, 0, 0, i as u8, side] };
            match has_wire && i == 0 {
                true => wire = Some(BridgedCable::lay(&end(a, 1), &end(b, 2), 1500)?),
                false => veth(&end(a, 1), &end(b, 2), 1500)?,
            }
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
        let mut ring = Self { switches, nodes, robot, cloud, wire, tools, bpffs, files };
        for i in 0..SWITCHES {
            ring.wait(&format!("s{} to know the shortest paths", i + 1), |ring| {
                let topology = ring.ctl(i, &["topology"])?;
                let ways = topology["switches"].as_array().into_iter().flatten();
                // The longer direction around the ring costs three.
                let is_shortest = |switch: &&Value| switch["cost"].as_u64().is_some_and(|cost| cost <= 2);
                let known = ways.filter(|switch| switch["next"].is_string()).filter(is_shortest);
                Ok(known.count() == SWITCHES - 1)
            })?;
        }
        Ok(ring)
    }

    /// Starts a proxy for the robot and one for the cloud, with these topics.
    pub fn start_proxies_of(&self, topics: &[FabricTopic]) -> Result<[Process; 2]> {
        let BothEnds { robot, cloud, .. } =
            Authority { tools: &self.tools, folder: self.files.path() }.topics(topics, &[])?;
        let start = |label, at: &Namespace, link, topics| {
            at.enable_loopback_multicast()?;
            let plan = ProxyPlan { links: vec![link], graphs: ros2(), topics, peers: None };
            plan.start(&self.tools, at, self.files.path(), label)
        };
        let cloud = start("cloud", &self.cloud, "eth://l0", cloud)?;
        Ok([start("robot", &self.robot, "eth://r0", robot)?, cloud])
    }

    /// Runs a `gdp-ctl` command against the daemon of switch `i` and returns its JSON.
    pub fn ctl(&self, i: usize, arguments: &[&str]) -> Result<Value> {
        self.switches[i].ctl(&self.tools, arguments)
    }

    /// Starts another daemon for switch `i`, whose daemon has ended.
    pub fn start_again(&mut self, i: usize) -> Result<()> {
        let names: Vec<String> = self.switches.iter().map(|switch| switch.name.clone()).collect();
        let (label, config) = (format!("s{}", i + 1), config(i, &names, &self.bpffs));
        let who = (label.as_str(), names[i].as_str());
        self.switches[i] = Switch::start(&self.tools, &self.nodes[i], self.files.path(), who, config)?;
        Ok(())
    }

    /// Waits until switch `i` reaches the RIB through next hop `next`.
    pub fn wait_for_way(&mut self, i: usize, next: usize) -> Result<()> {
        self.wait(&format!("s{} to ask the RIB by s{}", i + 1, next + 1), |ring| {
            let control = ring.ctl(i, &["status"])?["control"].clone();
            Ok(control["ready"] == true && control["next"] == *ring.switches[next].name)
        })
    }

    /// Returns the number of data frames that switch `i` forwarded without its daemon.
    pub fn forwarded(&self, i: usize) -> Result<u64> {
        let status = self.ctl(i, &["status"])?;
        Ok(status["counters_by_plane"]["forwarded"]["kernel"].as_u64().unwrap_or(0))
    }

    /// Returns the FIB generation of switch `i`, which increases with every update from the RIB.
    pub fn generation(&self, i: usize) -> Result<u64> {
        self.ctl(i, &["status"])?["fib"]["generation"].as_u64().context("no generation in the status")
    }

    /// Pulls the cable between switch `i` and the next, or plugs it in again.
    pub fn set_cable(&self, i: usize, plugged: bool) -> Result<()> {
        let state = if plugged { "up" } else { "down" };
        self.nodes[i].ip(&["link", "set", "r0", state]).map(drop)
    }

    /// Blocks every frame between s1 and s2, or lets all frames pass again. Both keep their
    /// carrier.
    pub fn cut_wire(&self, cut: bool) -> Result<()> {
        self.wire.as_ref().context("this ring was built without a wire")?.cut(cut)
    }

    /// Cuts switch `i` off with its daemon, as a power failure does.
    pub fn power_off(&mut self, i: usize) -> Result<()> {
        self.set_cables_of(i, false)?;
        self.switches[i].process.kill().map(drop)
    }

    /// Ends [`Self::power_off`].
    pub fn power_on(&mut self, i: usize) -> Result<()> {
        self.set_cables_of(i, true)?;
        self.start_again(i)
    }

    fn set_cables_of(&self, i: usize, plugged: bool) -> Result<()> {
        [(i + SWITCHES - 1) % SWITCHES, i].into_iter().try_for_each(|cable| self.set_cable(cable, plugged))
    }

    /// Returns the switches from the robot to the cloud, as each knows the next one.
    pub fn path(&self) -> Result<Vec<usize>> {
        let (mut at, mut path) = (ROBOT_AT, vec![ROBOT_AT]);
        while at != CLOUD_AT && path.len() <= SWITCHES {
            let topology = self.ctl(at, &["topology"])?;
            let to = topology["switches"].as_array().into_iter().flatten();
            let next = to.into_iter().find(|switch| switch["switch"] == *self.switches[CLOUD_AT].name);
            let next = next.and_then(|switch| switch["next"].as_str()).context("no path to the cloud")?;
            at = self.switches.iter().position(|switch| switch.name == next).context("a switch of the ring")?;
            path.push(at);
        }
        Ok(path)
    }

    /// Waits until a condition holds. An error, for example of a daemon that does not answer yet,
    /// counts as no.
    pub fn wait(&mut self, what: &str, condition: impl Fn(&Self) -> Result<bool>) -> Result<()> {
        wait_for(what, TIMEOUT, || Ok(condition(self).unwrap_or(false).then_some(()))).with_context(|| self.report())
    }

    /// Returns the folder of `robot` or `cloud`.
    pub fn folder_of(&self, party: &str) -> PathBuf {
        self.files.path().join(party)
    }

    /// Returns the end of every daemon's output, for a failure message.
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
