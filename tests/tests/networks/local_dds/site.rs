//! The site of these tests: a robot, its arm and a cloud, with proxies and a switch.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Result, ensure};
use gdp_tests::Tools;
use gdp_tests::fabric::{Authority, Switch, TOPIC, TYPE};
use gdp_tests::netns::{End, Namespace, veth};
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};

/// The topic that crosses from the cloud to the robot.
pub const COMMANDS: &str = "/commands";

/// The text of messages, which occurs in no other traffic.
pub const TEXT: &str = "for nodes of this graph alone";

#[derive(Clone, Copy, Debug)]
pub enum Vendor {
    /// Fast DDS 3, beneath Kilted's rclpy.
    Rclpy,
    /// Fast DDS 2.
    FastDds,
    Cyclone,
}

impl Vendor {
    pub const ALL: [Self; 3] = [Self::Rclpy, Self::FastDds, Self::Cyclone];
}

/// A running site. Dropping it ends the programs, then deletes the namespaces and files.
pub struct Site {
    pub proxies: Vec<Process>,
    _switch: Switch,
    pub robot: Namespace,
    pub arm: Namespace,
    pub cloud: Namespace,
    pub tools: Tools,
    pub folder: tempfile::TempDir,
}

impl Site {
    /// `commands` topics cross to the robot: [`COMMANDS`], and others with a number appended.
    pub fn build(commands: usize) -> Result<Self> {
        let tools = Tools::beside_this_test()?;
        let [robot, arm, cloud] = [Namespace::create("robot")?, Namespace::create("arm")?, Namespace::create("cloud")?];
        for (i, (interface, other)) in [("up0", &cloud), ("in0", &arm)].into_iter().enumerate() {
            let mac = |end| [2, 0, 0, 5, end, i as u8];
            let near = End { namespace: &robot, interface, mac: mac(0) };
            veth(&near, &End { namespace: other, interface: "e0", mac: mac(1) }, 1500)?;
            robot.ip(&["addr", "add", &format!("10.77.{i}.2/24"), "dev", interface])?;
            other.ip(&["addr", "add", &format!("10.77.{i}.3/24"), "dev", "e0"])?;
        }
        // The robot resembles a host with a default route; the far side, a host that restricts DDS
        // to itself.
        robot.ip(&["route", "add", "default", "via", "10.77.0.3"])?;
        cloud.enable_loopback_multicast()?;

        let folder = tempfile::Builder::new().prefix("gdp-local-dds-").tempdir()?;
        let authority = Authority { tools: &tools, folder: folder.path() };
        let name = authority.switch("s1")?;
        let config = json!({"interfaces": [], "udp": "0.0.0.0:31415", "data_plane": "userspace", "rib": true});
        let switch = Switch::start(&tools, &robot, folder.path(), ("s1", &name), config)?;
        wait_for("the switch", TIMEOUT, || Ok(switch.ctl(&tools, &["status"]).ok()))?;
        authority.topic()?;
        for i in 0..commands {
            authority.name("topic", &command_topic(i), TYPE, &format!("commands{i}.card"))?;
        }
        let mut site = Self { proxies: Vec::new(), _switch: switch, robot, arm, cloud, tools, folder };
        for (i, (label, to)) in [("robot", "udp://127.0.0.1"), ("cloud", "udp://10.77.0.2")].into_iter().enumerate() {
            let proxy = site.proxy(label, i, to, commands)?;
            site.proxies.push(proxy);
        }
        Ok(site)
    }

    /// Starts a proxy. The robot's publishes [`TOPIC`] and reads the commands; the other one does
    /// the reverse.
    fn proxy(&self, label: &str, domain: usize, link: &str, commands: usize) -> Result<Process> {
        let authority = Authority { tools: &self.tools, folder: self.folder.path() };
        let entity = authority.proxy(label)?;
        let chatter = ("chatter".to_owned(), TOPIC.to_owned(), 0);
        let commands = (0..commands).map(|i| (format!("commands{i}"), command_topic(i), 1));
        let topics = std::iter::once(chatter).chain(commands).map(|(file, topic, source)| {
            let (direction, key, right) =
                if source == domain { ("out", "cert", "--publish") } else { ("in", "grant", "--read") };
            authority.hand(label, &entity, &[right], &file)?;
            let (card, cert) = (format!("{file}.card"), format!("{file}.cert"));
            Ok(json!({"topic": topic, "direction": direction, "card": card, (key): cert}))
        });
        let config = json!({
            "version": 1, "identity": "key.pem", "links": [{"to": link}],
            "graphs": {"ros2": {"domain_id": domain}}, "topics": topics.collect::<Result<Vec<_>>>()?,
        });
        let path = self.folder.path().join(label).join("proxy.yaml");
        // JSON is YAML.
        fs::write(&path, config.to_string())?;
        let at = if domain == 0 { &self.robot } else { &self.cloud };
        Process::spawn(&format!("{label}-proxy"), self.proxy_command(at, label)?, self.folder.path())
    }

    fn proxy_command(&self, at: &Namespace, label: &str) -> Result<Command> {
        let mut command = at.command(self.tools.gdp_proxy()?)?;
        command.arg("--config").arg(self.folder.path().join(label).join("proxy.yaml"));
        command.arg("--stats").arg(self.stats_file(label));
        Ok(command)
    }

    /// Restarts the robot's proxy with this environment variable.
    pub fn restart_robot_proxy(&mut self, variable: &str, value: &str) -> Result<()> {
        ensure!(self.proxies[0].stop(TIMEOUT)?.success(), "{}", self.report());
        let mut command = self.proxy_command(&self.robot, "robot")?;
        command.env(variable, value);
        self.proxies[0] = Process::spawn("robot-proxy", command, self.folder.path())?;
        Ok(())
    }

    pub fn talk(&self, vendor: Vendor, at: &Namespace, domain: u16, topic: &str, options: &[&str]) -> Result<Process> {
        let mut command = self.peer(vendor, at, "talk", domain, topic)?;
        command.args(["--text", TEXT]).args(options).arg("--gate").arg(self.gate());
        Process::spawn("talker", command, self.folder.path())
    }

    pub fn listen(&self, vendor: Vendor, at: &Namespace, domain: u16, topic: &str) -> Result<Process> {
        let command = self.peer(vendor, at, "listen", domain, topic)?;
        Process::spawn(&format!("{vendor:?}-listener"), command, self.folder.path())
    }

    pub fn peer(&self, vendor: Vendor, at: &Namespace, verb: &str, domain: u16, topic: &str) -> Result<Command> {
        let (domain, dds) = (domain.to_string(), format!("rt{topic}"));
        let command = match vendor {
            Vendor::FastDds => at.command(self.tools.fastdds()?)?,
            Vendor::Cyclone | Vendor::Rclpy => at.command(self.tools.python()?)?,
        };
        let mut command = command;
        match vendor {
            Vendor::FastDds => command.args([verb, "--domain", &domain, "--topic", &dds]),
            Vendor::Cyclone => command.arg(self.tools.cyclone()).args([verb, "--domain", &domain, "--topic", &dds]),
            Vendor::Rclpy => {
                command.arg(self.tools.peer("rclpy_topic.py")).args([verb, "--topic", topic]);
                command.env("ROS_DOMAIN_ID", domain).env("ROS_LOG_DIR", self.folder.path());
                // UDP alone: two Fast DDS programs on one machine would otherwise communicate
                // through shared memory.
                command.env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
            }
        };
        Ok(command)
    }

    /// Returns the gate file. Talkers send warm-up messages until it exists.
    pub fn gate(&self) -> PathBuf {
        self.folder.path().join("gate")
    }

    fn stats_file(&self, label: &str) -> PathBuf {
        self.folder.path().join(label).join("stats.json")
    }

    pub fn stats(&self, label: &str) -> Value {
        let text = fs::read(self.stats_file(label)).unwrap_or_default();
        serde_json::from_slice(&text).unwrap_or_default()
    }

    pub fn report(&self) -> String {
        self.proxies.iter().map(Process::report).collect::<Vec<_>>().join("\n")
    }
}

/// Returns the name of one of the topics that cross to the robot.
fn command_topic(number: usize) -> String {
    if number == 0 { COMMANDS.to_owned() } else { format!("{COMMANDS}{number}") }
}
