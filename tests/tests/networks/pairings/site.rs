//! The network, its switch, its ROS masters and the proxies. A test chooses what crosses, and
//! starts the programs.
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

/// The ROS implementation of a program.
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

    /// Returns the robot's graph that this vendor's programs are in.
    fn graph(self) -> &'static str {
        if self == Self::Rospy { "old" } else { "new" }
    }

    /// Returns the vendor's name for a topic, service or action.
    pub fn name(self, of: &str) -> String {
        format!("/{}/{of}", self.label())
    }
}

/// A topic, service or action from one of the robot's programs to both sites.
pub struct Carried {
    /// `topic`, `service` or `action`.
    pub what: &'static str,
    pub name: String,
    /// The type in ROS 2's notation.
    pub kind: String,
    /// The vendor of the robot's program.
    pub source: Vendor,
}

impl Carried {
    /// Returns whether a site gets it. A graph of ROS 1 has no actions: there they are topics.
    fn is_for(&self, label: &str) -> bool {
        self.what != "action" || label != "old"
    }

    /// Returns the base name of its card and certificates.
    fn file(&self) -> String {
        self.name.trim_start_matches('/').replace('/', "-")
    }
}

/// A running site. Dropping it ends the programs, then deletes the namespaces and files.
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
    /// Creates the folder for [`Site::start`].
    pub fn files() -> Result<TempDir> {
        Ok(tempfile::Builder::new().prefix("gdp-pairings-").tempdir()?)
    }

    /// Starts everything except the programs under test. `more`: additional configuration of the
    /// robot's proxy.
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

    /// Returns the folder of the files and all logs.
    pub fn folder(&self) -> &Path {
        self.files.path()
    }

    /// Returns the namespace of a vendor's programs at the receiving end.
    pub fn sink(&self, vendor: Vendor) -> &Namespace {
        if vendor == Vendor::Rospy { &self.old } else { &self.new }
    }

    /// Returns a command for a ROS 1 program of `tests/peers`, with the master of its namespace.
    pub fn ros1(&self, at: &Namespace, peer: &str) -> Result<Command> {
        ros1(at, self.folder(), &self.tools.peer(peer))
    }

    /// Returns a command for a Cyclone DDS or rclpy program of `tests/peers`.
    pub fn python(&self, at: &Namespace, peer: &str) -> Result<Command> {
        let mut command = at.command(self.tools.python()?)?;
        // UDP alone: two Fast DDS programs on one machine would otherwise communicate through
        // shared memory, past the network.
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

    /// Starts the proxies. The robot's proxy is in both of the robot's graphs.
    fn start_proxies(&mut self, carried: &[Carried], more: Value) -> Result<()> {
        let authority = Authority { tools: &self.tools, folder: self.files.path() };
        let labels = ["robot", "old", "new"];
        let entities = labels.map(|label| authority.proxy(label)).into_iter().collect::<Result<Vec<_>>>()?;
        authority.topic()?;
        // Entries by label, then by list of the configuration.
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

/// The ROS master's address; each namespace has its own master.
const MASTER: &str = "http://localhost:11311";

/// Creates the namespaces of switch, robot, old site and new site.
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

/// Returns a command for a program of Debian's ROS 1, in Debian's Python; `PATH` may list another
/// one first.
fn ros1(at: &Namespace, folder: &Path, program: &Path) -> Result<Command> {
    let mut command = at.command(Program::Python3)?;
    command.arg(program).env("ROS_MASTER_URI", MASTER).env("ROS_HOSTNAME", "localhost").env_remove("ROS_IP");
    command.env("ROS_HOME", folder).env("ROS_LOG_DIR", folder);
    Ok(command)
}
