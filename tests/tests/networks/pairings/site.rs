//! The network, its switch, the proxies, and the programs of `tests/peers/any`.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use gdp_tests::Tools;
use gdp_tests::fabric::{Authority, PATIENCE, Switch};
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::wait::wait_for;
use serde_json::{Value, json};

/// What is published: the files of `samples.py`.
pub const KEYS: [&str; 6] = ["string", "image", "cloud", "joints", "tf", "report"];

/// Whose ROS a program is made with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vendor {
    Rospy,
    Cyclone,
    FastDds,
}

impl Vendor {
    pub const ALL: [Self; 3] = [Self::Rospy, Self::Cyclone, Self::FastDds];

    fn label(self) -> &'static str {
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

    /// What it publishes of a type.
    pub fn topic(self, key: &str) -> String {
        format!("/{}/{key}", self.label())
    }
}

/// Dropping it ends the programs, then removes the namespaces and files.
pub struct Site {
    pub programs: Vec<Process>,
    proxies: Vec<Process>,
    _masters: Vec<Process>,
    _switch: Switch,
    robot: Namespace,
    old: Namespace,
    new: Namespace,
    _s1: Namespace,
    tools: Tools,
    files: tempfile::TempDir,
    /// By key, as ROS 2 calls it.
    types: Value,
}

impl Site {
    /// Everything but the programs that publish and hear.
    pub fn start() -> Result<Self> {
        let tools = Tools::beside_this_test()?;
        let files = tempfile::Builder::new().prefix("gdp-pairings-").tempdir()?;
        let folder = files.path();
        execute(Command::new(tools.python()?).arg(tools.peer("any/samples.py")).arg(folder))?;
        let index: Value = serde_json::from_str(&fs::read_to_string(folder.join("index.json"))?)?;
        let types = KEYS.iter().map(|key| ((*key).to_owned(), index[key]["type"].clone())).collect();

        let [s1, robot, old, new] = network()?;
        let authority = Authority { tools: &tools, folder };
        let name = authority.switch("s1")?;
        let config = json!({
            "interfaces": ["p0", "p1", "p2"], "udp": null, "data_plane": "xdp", "bpffs": null, "rib": true,
        });
        let switch = Switch::start(&tools, &s1, folder, ("s1", &name), config)?;
        wait_for("the switch", PATIENCE, || Ok(switch.ctl(&tools, &["status"]).ok()))?;

        let masters = [("robot", &robot), ("old", &old)].map(|(label, at)| master(label, at, folder));
        let _masters = masters.into_iter().collect::<Result<Vec<_>>>()?;
        let (programs, proxies) = (Vec::new(), Vec::new());
        let mut site =
            Self { programs, proxies, _masters, _switch: switch, robot, old, new, _s1: s1, tools, files, types };
        site.start_proxies()?;
        Ok(site)
    }

    /// Publishes every type, beneath `/VENDOR`.
    pub fn talk(&self, vendor: Vendor) -> Result<Process> {
        self.program(vendor, "talk", &self.robot, &[&format!("/{}", vendor.label())])
    }

    /// Hears every type from each vendor.
    pub fn listen(&self, vendor: Vendor) -> Result<Process> {
        let prefixes = Vendor::ALL.map(|source| format!("/{}", source.label()));
        let at = if vendor == Vendor::Rospy { &self.old } else { &self.new };
        self.program(vendor, "listen", at, &prefixes.each_ref().map(String::as_str))
    }

    pub fn check_alive(&mut self) -> Result<()> {
        self.programs.iter_mut().chain(&mut self.proxies).try_for_each(Process::check_alive)
    }

    pub fn report(&self) -> String {
        self.programs.iter().chain(&self.proxies).map(Process::report).collect::<Vec<_>>().join("\n")
    }

    fn program(&self, vendor: Vendor, verb: &str, at: &Namespace, prefixes: &[&str]) -> Result<Process> {
        let folder = self.files.path();
        let mut command = match vendor {
            Vendor::Rospy => ros1(at, folder, &self.tools.peer("any/rospy_any.py"))?,
            Vendor::Cyclone => {
                let mut command = at.command(self.tools.python()?)?;
                command.arg(self.tools.peer("any/cyclone_any.py"));
                command
            }
            Vendor::FastDds => at.command(self.tools.fastdds_any()?)?,
        };
        command.arg(verb).arg(folder);
        if vendor == Vendor::FastDds {
            let types = KEYS.map(|key| format!("{key}={}", self.types[key].as_str().unwrap_or_default()));
            command.arg(prefixes.join(",")).args(types);
        } else {
            command.args(prefixes);
        }
        Process::spawn(&format!("{}-{verb}", vendor.label()), command, folder)
    }

    /// The robot's is in both of its graphs, and alone knows what the type of the unknown package is, from a folder.
    fn start_proxies(&mut self) -> Result<()> {
        let folder = self.files.path();
        let authority = Authority { tools: &self.tools, folder };
        let entities =
            ["robot", "old", "new"].map(|label| authority.proxy(label)).into_iter().collect::<Result<Vec<_>>>()?;
        authority.topic()?;
        let (mut out, mut into) = (Vec::new(), Vec::new());
        for source in Vendor::ALL {
            for key in KEYS {
                let (topic, name) = (source.topic(key), format!("{}-{key}", source.label()));
                authority.name(&topic, self.types[key].as_str().context("a type")?, &format!("{name}.card"))?;
                for (label, entity) in ["robot", "old", "new"].iter().zip(&entities) {
                    let right = if *label == "robot" { "--publish" } else { "--read" };
                    authority.hand(label, entity, &[right], &name)?;
                }
                let (card, cert) = (format!("{name}.card"), format!("{name}.cert"));
                out.push(
                    json!({"topic": topic, "graph": source.graph(), "direction": "out", "card": card, "cert": cert}),
                );
                into.push(json!({"topic": topic, "direction": "in", "card": card, "grant": cert}));
            }
        }
        let (ros1, ros2) = (json!({"master": MASTER, "host": "localhost"}), json!({"domain_id": 0}));
        let robot = json!({
            "graphs": {"old": ros1, "new": ros2}, "topics": out, "definitions": {"ros2": [folder.join("share")]},
        });
        let old = json!({"graphs": {"old": ros1}, "topics": into});
        let new = json!({"graphs": {"new": ros2}, "topics": into});
        let parties =
            [("robot", &self.robot, "r0", robot), ("old", &self.old, "l0", old), ("new", &self.new, "l0", new)];
        self.proxies = parties
            .into_iter()
            .map(|(label, at, interface, config)| self.proxy(label, at, interface, config))
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
        Process::spawn(&format!("{label}-proxy"), command, self.files.path())
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
    let mut command = ros1(at, folder, Path::new("/usr/bin/rosmaster"))?;
    command.args(["--core", "-p", "11311"]);
    Process::spawn(&format!("{label}-master"), command, folder)
}

/// A program of Debian's ROS 1, in the Python that it is installed for; another may come first in `PATH`.
fn ros1(at: &Namespace, folder: &Path, program: &Path) -> Result<Command> {
    let mut command = at.command("/usr/bin/python3")?;
    command.arg(program).env("ROS_MASTER_URI", MASTER).env("ROS_HOSTNAME", "localhost").env_remove("ROS_IP");
    command.env("ROS_HOME", folder).env("ROS_LOG_DIR", folder);
    Ok(command)
}
