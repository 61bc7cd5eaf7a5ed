//! The network, its switch, its masters and the proxies. What crosses is said by the test, which
//! starts the programs as well.
//!
//! ```text
//!                         ┌ p1 ── l0 old: rospy at a master
//!   robot r0 ── p0 switch ┤
//!   all three             └ p2 ── l0 new: Cyclone DDS, Fast DDS
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use gdp_tests::Tools;
use gdp_tests::fabric::{Authority, Switch};
use gdp_tests::netns::{End, Namespace, veth};
use gdp_tests::process::Process;
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Whose ROS a program is made with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vendor {
    Rospy,
    Cyclone,
    FastDds,
}

impl Vendor {
    pub const ALL: [Self; 3] = [Self::Rospy, Self::Cyclone, Self::FastDds];

    pub fn label(self) -> &'static str {
        match self {
            Self::Rospy => "rospy",
            Self::Cyclone => "cyclone",
            Self::FastDds => "fastdds",
        }
    }

    /// Of the robot's graphs, which it is in.
    fn graph(self) -> &'static str {
        if self == Self::Rospy { "old" } else { "new" }
    }

    /// What it has of something that each vendor has.
    pub fn name(self, of: &str) -> String {
        format!("/{}/{of}", self.label())
    }
}

/// What crosses, from a program of the robot's to both sites.
pub struct Carried {
    /// `topic`, `service` or `action`.
    pub what: &'static str,
    pub name: String,
    /// As ROS 2 calls it.
    pub kind: String,
    /// Whose program at the robot has it.
    pub source: Vendor,
}

impl Carried {
    /// Whether it is for a site. A graph of ROS 1 has no actions: there they are topics.
    fn is_for(&self, label: &str) -> bool {
        self.what != "action" || label != "old"
    }

    /// What its card and certificates are called.
    fn file(&self) -> String {
        self.name.trim_start_matches('/').replace('/', "-")
    }
}

/// Dropping it ends the programs, then removes the namespaces and files.
pub struct Site {
    pub programs: Vec<Process>,
    proxies: Vec<Process>,
    _masters: Vec<Process>,
    _switch: Switch,
    pub robot: Namespace,
    old: Namespace,
    pub new: Namespace,
    _s1: Namespace,
    pub tools: Tools,
    files: TempDir,
}

impl Site {
    /// For [`Site::start`].
    pub fn files() -> Result<TempDir> {
        Ok(tempfile::Builder::new().prefix("gdp-pairings-").tempdir()?)
    }

    /// Everything but the programs that have what is carried. `more`: what else the robot's proxy
    /// is configured with.
    pub fn start(tools: Tools, files: TempDir, carried: &[Carried], more: Value) -> Result<Self> {
        let folder = files.path();
        let [s1, robot, old, new] = network()?;
        let authority = Authority { tools: &tools, folder };
        let name = authority.switch("s1")?;
        let config = json!({
            "interfaces": ["p0", "p1", "p2"], "udp": null, "data_plane": "xdp", "bpffs": null, "rib": true,
        });
        let switch = Switch::start(&tools, &s1, folder, ("s1", &name), config)?;
        wait_for("the switch", TIMEOUT, || Ok(switch.ctl(&tools, &["status"]).ok()))?;

        let masters = [("robot", &robot), ("old", &old)].map(|(label, at)| master(label, at, folder));
        let _masters = masters.into_iter().collect::<Result<Vec<_>>>()?;
        let (programs, proxies) = (Vec::new(), Vec::new());
        let mut site = Self { programs, proxies, _masters, _switch: switch, robot, old, new, _s1: s1, tools, files };
        site.start_proxies(carried, more)?;
        Ok(site)
    }

    /// Where the files and all logs are.
    pub fn folder(&self) -> &Path {
        self.files.path()
    }

    /// Where a vendor's programs are that have what comes from the robot.
    pub fn sink(&self, vendor: Vendor) -> &Namespace {
        if vendor == Vendor::Rospy { &self.old } else { &self.new }
    }

    /// A program of `tests/peers` for ROS 1, with the master of its namespace.
    pub fn ros1(&self, at: &Namespace, peer: &str) -> Result<Command> {
        ros1(at, self.folder(), &self.tools.peer(peer))
    }

    /// A program of `tests/peers` for Cyclone DDS or rclpy.
    pub fn python(&self, at: &Namespace, peer: &str) -> Result<Command> {
        let mut command = at.command(self.tools.python()?)?;
        // UDP alone: two Fast DDS programs of one machine would otherwise meet in shared memory,
        // past the network.
        command.arg(self.tools.peer(peer)).env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4").env("ROS_DOMAIN_ID", "0");
        command.env("ROS_LOG_DIR", self.folder());
        Ok(command)
    }

    pub fn spawn(&self, label: &str, command: Command) -> Result<Process> {
        Process::spawn(label, command, self.folder())
    }

    pub fn check_alive(&mut self) -> Result<()> {
        self.programs.iter_mut().chain(&mut self.proxies).try_for_each(Process::check_alive)
    }

    pub fn report(&self) -> String {
        self.programs.iter().chain(&self.proxies).map(Process::report).collect::<Vec<_>>().join("\n")
    }

    /// The robot's is in both of its graphs.
    fn start_proxies(&mut self, carried: &[Carried], more: Value) -> Result<()> {
        let authority = Authority { tools: &self.tools, folder: self.files.path() };
        let labels = ["robot", "old", "new"];
        let entities = labels.map(|label| authority.proxy(label)).into_iter().collect::<Result<Vec<_>>>()?;
        authority.topic()?;
        // By label, by the list of the configuration.
        let mut lists: BTreeMap<&str, BTreeMap<String, Vec<Value>>> = BTreeMap::new();
        for one in carried {
            let (name, what) = (one.file(), one.what);
            let (card, cert) = (format!("{name}.card"), format!("{name}.cert"));
            authority.name(what, &one.name, &one.kind, &card)?;
            for (label, entity) in labels.into_iter().zip(&entities).filter(|(label, _)| one.is_for(label)) {
                let (right, mut entry) = if label == "robot" {
                    let graph = one.source.graph();
                    ("--publish", json!({"graph": graph, "direction": "out", "card": card, "cert": cert}))
                } else {
                    ("--read", json!({"direction": "in", "card": card, "grant": cert}))
                };
                authority.hand(label, entity, &[right], &name)?;
                entry[what] = json!(one.name);
                lists.entry(label).or_default().entry(format!("{what}s")).or_default().push(entry);
            }
        }
        let (ros1, ros2) = (json!({"master": MASTER, "host": "localhost"}), json!({"domain_id": 0}));
        let graphs = [json!({"old": ros1, "new": ros2}), json!({"old": ros1}), json!({"new": ros2})];
        let places = [(&self.robot, "r0"), (&self.old, "l0"), (&self.new, "l0")];
        self.proxies = labels
            .into_iter()
            .zip(graphs)
            .zip(places)
            .map(|((label, graphs), (at, interface))| {
                let mut config = if label == "robot" { more.clone() } else { json!({}) };
                config["graphs"] = graphs;
                for (list, entries) in lists.remove(label).unwrap_or_default() {
                    config[list] = json!(entries);
                }
                self.proxy(label, at, interface, config)
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(())
    }

    fn proxy(&self, label: &str, at: &Namespace, interface: &str, mut config: Value) -> Result<Process> {
        config["version"] = json!(1);
        config["identity"] = json!("key.pem");
        config["links"] = json!([{"to": format!("eth://{interface}")}]);
        let path = self.files.path().join(label).join("proxy.yaml");
        // JSON is YAML.
        fs::write(&path, config.to_string())?;
        let mut command = at.command(self.tools.gdp_proxy()?)?;
        command.arg("--config").arg(&path);
        self.spawn(&format!("{label}-proxy"), command)
    }
}

/// Each namespace has its own.
const MASTER: &str = "http://localhost:11311";

/// Switch, robot, the old site, the new one.
fn network() -> Result<[Namespace; 4]> {
    let all = ["s1", "robot", "old", "new"].map(Namespace::create).into_iter().collect::<Result<Vec<_>>>()?;
    let all: [Namespace; 4] = all.try_into().ok().context("four namespaces")?;
    for (i, (end, interface)) in all[1..].iter().zip(["r0", "l0", "l0"]).enumerate() {
        let port = format!("p{i}");
        let mac = |end| [2, 0, 0, 4, end, i as u8];
        let near = End { namespace: &all[0], interface: &port, mac: mac(0) };
        veth(&near, &End { namespace: end, interface, mac: mac(1) }, 1500)?;
        end.enable_loopback_multicast()?;
    }
    Ok(all)
}

fn master(label: &str, at: &Namespace, folder: &Path) -> Result<Process> {
    let mut command = ros1(at, folder, Path::new(Program::Rosmaster.name()))?;
    command.args(["--core", "-p", "11311"]);
    Process::spawn(&format!("{label}-master"), command, folder)
}

/// A program of Debian's ROS 1, in the Python that it is installed for; another may come first in
/// `PATH`.
fn ros1(at: &Namespace, folder: &Path, program: &Path) -> Result<Command> {
    let mut command = at.command(Program::Python3)?;
    command.arg(program).env("ROS_MASTER_URI", MASTER).env("ROS_HOSTNAME", "localhost").env_remove("ROS_IP");
    command.env("ROS_HOME", folder).env("ROS_LOG_DIR", folder);
    Ok(command)
}
