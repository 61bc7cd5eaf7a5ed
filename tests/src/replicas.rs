//! Three switches in a triangle. Each runs a daemon that is a replica of the RIB, and a member of
//! etcd. A separate network connects the members. The robot is at the first switch, the cloud at
//! the second. Their traffic crosses the third, whose daemon starts first and leads.
//!
//! ```text
//!  robot r0 ── e0 s1 r0 ═══ 10 ═══ l0 s2 e0 ── l0 cloud
//!  later r0 ── f0  l0               r0  f0 ── l0 late
//!                   │               │
//!                   1               1          mx at each switch: etcd, by a bridge
//!                   │               │
//!                  r0 ──── s3 ──── l0
//! ```

use std::net::Ipv4Addr;
use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::etcd::Etcd;
use crate::fabric::{Authority, Mounted, Switch};
use crate::netns::{End, Namespace, veth};
use crate::tools::Tools;
use crate::wait::{TIMEOUT, wait_for};

const SWITCHES: usize = 3;

/// Indices of the robot's and the cloud's switch, and of the first leader; from 0.
pub const ROBOT_AT: usize = 0;
pub const CLOUD_AT: usize = 1;
pub const FIRST_LEADER: usize = 2;

/// The folder of the second owner, whose topic differs from that of robot and cloud.
const LATER: &str = "second";

/// Running replicas. Dropping it ends the daemons and members, then deletes the namespaces and
/// files.
pub struct Replicas {
    // Fields drop in this order: programs, network, file systems, files.
    pub switches: Vec<Switch>,
    pub etcd: Etcd,
    pub nodes: Vec<Namespace>,
    pub robot: Namespace,
    pub cloud: Namespace,
    /// A second robot at the first switch and a second cloud at the second, started later. Their
    /// topic belongs to another owner.
    pub late: [Namespace; 2],
    _bridge: Namespace,
    tools: Tools,
    bpffs: Mounted,
    files: tempfile::TempDir,
}

impl Replicas {
    /// Starts network, keys, etcd and daemons. Every switch knows a path to every other, and the
    /// third leads.
    pub fn start(tools: Tools) -> Result<Self> {
        let nodes: Vec<_> = (1..=SWITCHES).map(|i| Namespace::create(&format!("s{i}"))).collect::<Result<_>>()?;
        let [robot, cloud, late_robot, late_cloud] = ["robot", "cloud", "later", "late"].map(Namespace::create);
        let (robot, cloud, late) = (robot?, cloud?, [late_robot?, late_cloud?]);
        let bridge = Namespace::create("bridge")?;
        let ring = (0..SWITCHES).map(|i| ((&nodes[i], "r0"), (&nodes[(i + 1) % SWITCHES], "l0")));
        let ends = [
            ((&robot, "r0"), (&nodes[ROBOT_AT], "e0")),
            ((&nodes[CLOUD_AT], "e0"), (&cloud, "l0")),
            ((&late[0], "r0"), (&nodes[ROBOT_AT], "f0")),
            ((&nodes[CLOUD_AT], "f0"), (&late[1], "l0")),
        ];
        let own = ["m0", "m1", "m2"].into_iter().zip(&nodes).map(|(port, node)| ((node, "mx"), (&bridge, port)));
        for (i, (a, b)) in ring.chain(ends).chain(own).enumerate() {
            let end = |(namespace, interface), side| End { namespace, interface, mac: [2, 0, 0, 0, i as u8, side] };
            veth(&end(a, 1), &end(b, 2), 1500)?;
        }
        bridge.ip(&["link", "add", "br0", "type", "bridge"])?;
        bridge.ip(&["link", "set", "br0", "up"])?;
        for (i, node) in nodes.iter().enumerate() {
            bridge.ip(&["link", "set", &format!("m{i}"), "master", "br0"])?;
            node.ip(&["addr", "add", &format!("{}/24", address(i)), "dev", "mx"])?;
        }

        let files = tempfile::Builder::new().prefix("gdp-replicas-").tempdir().context("cannot create a folder")?;
        let names = Authority { tools: &tools, folder: files.path() }.switches(SWITCHES)?;
        for folder in [files.path().to_owned(), files.path().join(LATER)] {
            let authority = Authority { tools: &tools, folder: &folder };
            authority.topic()?;
            authority.admit("robot", "--publish")?;
            authority.admit("cloud", "--read")?;
        }
        let places: Vec<_> = nodes.iter().enumerate().map(|(i, node)| (node, address(i))).collect();
        let etcd = Etcd::start(&places, files.path())?;
        let bpffs = Mounted(files.path().join("bpf"));
        let start = |i: usize| {
            let label = format!("s{}", i + 1);
            Switch::start(&tools, &nodes[i], files.path(), (&label, &names[i]), config(i, &names, &bpffs, &etcd))
        };
        let first = start(FIRST_LEADER)?;
        wait_for("the first replica to lead", TIMEOUT, || {
            let leads = first.ctl(&tools, &["status"]).is_ok_and(|status| status["rib"].is_object());
            Ok(leads.then_some(()))
        })
        .with_context(|| first.process.report() + &etcd.report())?;
        let switches = vec![start(0)?, start(1)?, first];
        let mut replicas = Self { switches, etcd, nodes, robot, cloud, late, _bridge: bridge, tools, bpffs, files };
        replicas.wait_until_whole()?;
        Ok(replicas)
    }

    /// Waits until all daemons are up and adjacent, and the RIB knows them all.
    pub fn wait_until_whole(&mut self) -> Result<()> {
        self.wait("all switches to know all paths, and their RIB", |replicas| {
            for i in 0..SWITCHES {
                let (topology, status) = (replicas.ctl(i, &["topology"])?, replicas.ctl(i, &["status"])?);
                let ways = topology["switches"].as_array().into_iter().flatten();
                let known = ways.filter(|switch| switch["next"].is_string() && switch["cost"].is_u64()).count();
                if known < SWITCHES - 1 || status["control"]["ready"] != true {
                    return Ok(false);
                }
            }
            let leader = replicas.leader()?;
            Ok(replicas.ctl(leader, &["status"])?["rib"]["switches"] == SWITCHES)
        })
    }

    /// Returns the one leader among the replicas that answer.
    pub fn leader(&self) -> Result<usize> {
        let leads = |i: &usize| self.ctl(*i, &["status"]).is_ok_and(|status| status["rib"].is_object());
        let leading: Vec<_> = (0..SWITCHES).filter(leads).collect();
        match leading[..] {
            [leader] => Ok(leader),
            _ => anyhow::bail!("{} replicas lead", leading.len()),
        }
    }

    /// Runs a `gdp-ctl` command against the daemon of switch `i` and returns its JSON.
    pub fn ctl(&self, i: usize, arguments: &[&str]) -> Result<Value> {
        self.switches[i].ctl(&self.tools, arguments)
    }

    /// Kills the daemon of switch `i` and a member of etcd, both without a chance to clean up.
    pub fn kill(&mut self, i: usize, member: usize) -> Result<()> {
        self.switches[i].process.kill()?;
        self.etcd.kill(member)
    }

    /// Restarts the daemon of switch `i` and a member of etcd, which have both ended.
    pub fn start_again(&mut self, i: usize, member: usize) -> Result<()> {
        self.etcd.start_again(member, &self.nodes[member])?;
        let names: Vec<String> = self.switches.iter().map(|switch| switch.name.clone()).collect();
        let (label, config) = (format!("s{}", i + 1), config(i, &names, &self.bpffs, &self.etcd));
        let who = (label.as_str(), names[i].as_str());
        self.switches[i] = Switch::start(&self.tools, &self.nodes[i], self.files.path(), who, config)?;
        Ok(())
    }

    /// Waits until a condition holds. An error, for example of a daemon that does not answer yet,
    /// counts as no.
    pub fn wait(&mut self, what: &str, condition: impl Fn(&Self) -> Result<bool>) -> Result<()> {
        let limit = TIMEOUT * 3;
        wait_for(what, limit, || Ok(condition(self).unwrap_or(false).then_some(()))).with_context(|| self.report())
    }

    /// Returns the folder of `robot` or `cloud`.
    pub fn folder_of(&self, party: &str) -> PathBuf {
        self.files.path().join(party)
    }

    /// Returns the folder of the later robot or cloud.
    pub fn folder_of_late(&self, party: &str) -> PathBuf {
        self.files.path().join(LATER).join(party)
    }

    /// Returns the end of every program's output, for a failure message.
    pub fn report(&self) -> String {
        let daemons = self.switches.iter().map(|switch| switch.process.report());
        daemons.chain([self.etcd.report()]).collect::<Vec<_>>().join("\n")
    }
}

/// Returns the address of an etcd member.
fn address(i: usize) -> Ipv4Addr {
    Ipv4Addr::new(10, 77, 0, i as u8 + 1)
}

fn config(i: usize, names: &[String], bpffs: &Mounted, etcd: &Etcd) -> Value {
    let (before, after) = ((i + SWITCHES - 1) % SWITCHES, (i + 1) % SWITCHES);
    // The path through the third switch is the shorter one.
    let cost = |to: usize| if i == FIRST_LEADER || to == FIRST_LEADER { 1 } else { 10 };
    let left = json!({"interface": "l0", "switch": names[before], "cost": cost(before)});
    let right = json!({"interface": "r0", "switch": names[after], "cost": cost(after)});
    let interfaces = if i == FIRST_LEADER { vec!["l0", "r0"] } else { vec!["l0", "r0", "e0", "f0"] };
    json!({
        "interfaces": interfaces,
        "udp": null,
        "data_plane": "xdp",
        "bpffs": bpffs.0,
        "fib_capacity": 1024,
        "rib": true,
        "etcd": etcd.config(),
        "neighbours": [left, right],
    })
}
