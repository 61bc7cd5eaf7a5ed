//! The network of the soak, its programs, and what kills and restarts them.

use std::fs;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use gdp_tests::Tools;
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::fabric::{Authority, Switch, TOPIC, TYPE};
use gdp_tests::netns::Namespace;
use gdp_tests::peers::{Traffic, Vendor, listener, talker};
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};

use super::SETTLED;
use super::usage::Usage;

/// Nodes that come and go, and are all there at the end. Each has a topic.
pub const NODES: usize = 40;

/// Messages a second on the topic by which missed ones are counted.
const RATE: u32 = 20;

/// What is killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Program {
    RobotProxy,
    CloudProxy,
    Switch,
    /// The publisher of large messages.
    Camera,
    /// The server of a service.
    Lamp,
}

impl Program {
    pub const ALL: [Self; 5] = [Self::RobotProxy, Self::CloudProxy, Self::Switch, Self::Camera, Self::Lamp];

    pub fn is_proxy(self) -> bool {
        matches!(self, Self::RobotProxy | Self::CloudProxy)
    }
}

/// A kill -9 and what it cost.
#[derive(Clone, Copy, Debug)]
pub struct Kill {
    pub program: Program,
    /// From the kill until the program's log says that it works again.
    pub restart: Duration,
    /// The time that the missed messages stand for.
    pub missed: Duration,
}

impl Kill {
    pub fn json(&self) -> Value {
        let program = format!("{:?}", self.program);
        json!({"program": program, "restart_s": self.restart.as_secs_f64(), "missed_s": self.missed.as_secs_f64()})
    }
}

/// A running site. Dropping it ends the programs, then deletes the namespaces and files.
pub struct Site {
    robot: Process,
    cloud: Process,
    switch: Switch,
    camera: Process,
    lamp: Process,
    nodes: [Process; 2],
    clock: [Process; 2],
    viewer: Process,
    /// Lines that ended programs have logged: robot, cloud, switch.
    lines: [usize; 3],
    starts: usize,
    switch_name: String,
    chain: Chain,
    tools: Tools,
    files: tempfile::TempDir,
}

impl Site {
    pub fn start(seed: u64) -> Result<Self> {
        let tools = Tools::beside_this_test()?;
        let chain = Chain::build(ChainOptions { switches: 1, ..Default::default() })?;
        let files = tempfile::Builder::new().prefix("gdp-soak-").tempdir()?;
        let folder = files.path();
        let authority = Authority { tools: &tools, folder };
        let switch_name = authority.switch("s1")?;
        let switch = start_switch(&tools, &chain, folder, &switch_name)?;
        for at in [chain.robot(), chain.cloud()] {
            at.enable_loopback_multicast()?;
        }
        configure(&authority)?;
        let robot = proxy(&tools, chain.robot(), folder, "robot", 0)?;
        let cloud = proxy(&tools, chain.cloud(), folder, "cloud", 0)?;
        let camera = camera(&tools, chain.robot(), folder, 0)?;
        let lamp = lamp(&tools, chain.robot(), folder, "switch", 0)?;
        let nodes = [
            nodes(&tools, chain.robot(), folder, "talk", seed)?,
            nodes(&tools, chain.cloud(), folder, "listen", seed)?,
        ];
        let traffic = Traffic { rate: f64::from(RATE), ..Default::default() };
        let clock = [
            talker(&tools, chain.robot(), Vendor::Cyclone, &traffic, folder)?,
            listener(&tools, chain.cloud(), Vendor::Cyclone, &traffic, folder)?,
        ];
        let mut viewer = chain.cloud().command(tools.python()?)?;
        viewer.arg(tools.peer("cyclone.py")).args(["listen", "--topic", "rt/large"]);
        let viewer = Process::spawn("viewer", viewer, folder)?;
        let (lines, starts) = ([0; 3], 0);
        Ok(Self {
            robot,
            cloud,
            switch,
            camera,
            lamp,
            nodes,
            clock,
            viewer,
            lines,
            starts,
            switch_name,
            chain,
            tools,
            files,
        })
    }

    /// Waits until every route carries something new: the clock, the large topic, the service, and
    /// the topics of this many nodes. With `together`, all nodes return before, and stay.
    pub fn wait_for_all(&mut self, nodes: usize, together: bool) -> Result<()> {
        let report = [&self.robot, &self.cloud, &self.switch.process].map(Process::report).join("\n");
        if together {
            fs::write(self.files.path().join("gate"), "")?;
        }
        let heard = self.last_sequence();
        let viewed = self.viewed();
        let listen = |process: &Process| {
            let last = process.json_lines().pop()?;
            let is_settled = !together || last["settled"] == true;
            let topics = last["topics"].as_u64().unwrap_or(0) as usize;
            (is_settled && topics >= nodes).then_some(())
        };
        let found = self.nodes[1].wait_until("the topics of the nodes", SETTLED, listen);
        found.with_context(|| format!("{report}\n{}", self.missing()))?;
        wait_for("the clock", SETTLED, || Ok((self.last_sequence() > heard).then_some(())))?;
        wait_for("a large message", SETTLED, || Ok((self.viewed() > viewed).then_some(())))?;
        self.starts += 1;
        let mut client = lamp(&self.tools, self.chain.cloud(), self.files.path(), "set", self.starts)?;
        client.wait_event("response", SETTLED).with_context(|| report)?;
        Ok(())
    }

    /// Kills a program without a goodbye, starts it again, and waits until messages arrive again.
    pub fn kill(&mut self, program: Program) -> Result<Kill> {
        let before = self.last_sequence();
        let since = Instant::now();
        self.starts += 1;
        let (folder, number) = (self.files.path(), self.starts);
        match program {
            Program::RobotProxy => {
                self.robot.kill()?;
                self.lines[0] += lines(&self.robot);
                self.robot = proxy(&self.tools, self.chain.robot(), folder, "robot", number)?;
            }
            Program::CloudProxy => {
                self.cloud.kill()?;
                self.lines[1] += lines(&self.cloud);
                self.cloud = proxy(&self.tools, self.chain.cloud(), folder, "cloud", number)?;
            }
            Program::Switch => {
                self.switch.process.kill()?;
                self.lines[2] += lines(&self.switch.process);
                self.switch = start_switch(&self.tools, &self.chain, folder, &self.switch_name)?;
            }
            Program::Camera => {
                self.camera.kill()?;
                self.camera = camera(&self.tools, self.chain.robot(), folder, number)?;
            }
            Program::Lamp => {
                self.lamp.kill()?;
                self.lamp = lamp(&self.tools, self.chain.robot(), folder, "switch", number)?;
            }
        }
        let working = |process: &mut Process| {
            process.wait_until("the graphs", TIMEOUT, |process| {
                process.stderr().contains("in the ROS graphs").then_some(())
            })
        };
        match program {
            Program::RobotProxy => working(&mut self.robot)?,
            Program::CloudProxy => working(&mut self.cloud)?,
            _ => {}
        }
        let restart = since.elapsed();
        let restarted = self.last_sequence();
        let reports = || [&self.robot, &self.cloud, &self.switch.process].map(Process::report).join("\n");
        // Ten in a row: what is under way at the kill is no sign.
        wait_for("the clock", SETTLED, || Ok((self.last_sequence() > restarted + 10).then_some(())))
            .with_context(|| format!("{program:?}\n{}", reports()))?;
        let after = self.last_sequence();
        let arrived =
            sequences(&self.clock[1]).into_iter().filter(|sequence| (before + 1..=after).contains(sequence)).count();
        let missed = ((after - before) as u32).saturating_sub(arrived as u32);
        Ok(Kill { program, restart, missed: Duration::from_secs(1) * missed / RATE })
    }

    pub fn usage(&self) -> Result<Vec<Usage>> {
        let programs = [("robot-proxy", &self.robot), ("cloud-proxy", &self.cloud), ("switch", &self.switch.process)];
        programs.into_iter().map(|(name, process)| Usage::of(name, process)).collect()
    }

    /// Returns what each program has logged so far, with its earlier runs.
    pub fn log_lines(&self) -> [(&'static str, usize); 3] {
        let [robot, cloud, switch] = self.lines;
        [
            ("robot-proxy", robot + lines(&self.robot)),
            ("cloud-proxy", cloud + lines(&self.cloud)),
            ("switch", switch + lines(&self.switch.process)),
        ]
    }

    pub fn check_alive(&mut self) -> Result<()> {
        let programs = [&mut self.robot, &mut self.cloud, &mut self.switch.process, &mut self.camera, &mut self.lamp];
        programs.into_iter().chain(&mut self.nodes).chain(&mut self.clock).try_for_each(Process::check_alive)
    }

    /// Describes the topics of the nodes that do not arrive, as both proxies show them.
    fn missing(&self) -> String {
        let last = self.nodes[1].json_lines().pop().unwrap_or_default();
        let missing = last["missing"].as_array().cloned().unwrap_or_default();
        let names: Vec<String> = missing.iter().map(|number| format!("/churn/t{number}")).collect();
        let of = |label: &str| {
            let text = fs::read_to_string(self.files.path().join(label).join("stats.json")).unwrap_or_default();
            let stats: Value = serde_json::from_str(&text).unwrap_or_default();
            let topics = stats["topics"].as_array().cloned().unwrap_or_default();
            let shown = topics.iter().filter(|topic| names.iter().any(|name| topic["topic"] == name.as_str()));
            shown.map(|topic| format!("{label}: {topic}\n")).collect::<String>()
        };
        format!("missing: {names:?}\n{}{}", of("robot"), of("cloud"))
    }

    fn last_sequence(&self) -> i64 {
        sequences(&self.clock[1]).last().copied().unwrap_or(-1)
    }

    fn viewed(&self) -> usize {
        self.viewer.stdout().matches("\"message\"").count()
    }
}

fn sequences(listener: &Process) -> Vec<i64> {
    listener.json_lines().iter().filter_map(|line| line["seq"].as_i64()).collect()
}

fn lines(process: &Process) -> usize {
    process.stderr().lines().count()
}

fn start_switch(tools: &Tools, chain: &Chain, folder: &std::path::Path, name: &str) -> Result<Switch> {
    let config = json!({"interfaces": ["l0", "r0"], "udp": null, "data_plane": "xdp", "bpffs": null, "rib": true});
    let switch = Switch::start(tools, &chain.switches()[0], folder, ("s1", name), config)?;
    wait_for("the switch", TIMEOUT, || Ok(switch.ctl(tools, &["status"]).ok()))?;
    Ok(switch)
}

/// Creates the names, and the configurations of both proxies.
fn configure(authority: &Authority<'_>) -> Result<()> {
    authority.topic()?;
    let mut names: Vec<(&str, String, &str)> = vec![
        ("topic", TOPIC.into(), TYPE),
        ("topic", "/large".into(), TYPE),
        ("service", "/lamp".into(), "std_srvs/srv/SetBool"),
    ];
    names.extend((0..NODES).map(|number| ("topic", format!("/churn/t{number}"), TYPE)));
    for (i, (what, name, kind)) in names.iter().enumerate() {
        authority.name(what, name, kind, &format!("{i}.card"))?;
    }
    let sides = [("robot", "out", "cert", "--publish", "r0"), ("cloud", "in", "grant", "--read", "l0")];
    for (label, direction, key, right, interface) in sides {
        let entity = authority.proxy(label)?;
        let (mut topics, mut services) = (Vec::new(), Vec::new());
        for (i, (what, name, _)) in names.iter().enumerate() {
            authority.hand(label, &entity, &[right], &i.to_string())?;
            let (card, cert) = (format!("{i}.card"), format!("{i}.cert"));
            let list = if *what == "topic" { &mut topics } else { &mut services };
            list.push(json!({(*what): name, "direction": direction, "card": card, (key): cert}));
        }
        let config = json!({
            "version": 1, "identity": "key.pem", "links": [{"to": format!("eth://{interface}")}],
            "graphs": {"ros2": {"domain_id": 0}}, "topics": topics, "services": services,
        });
        // JSON is YAML.
        fs::write(authority.folder.join(label).join("proxy.yaml"), config.to_string())?;
    }
    Ok(())
}

fn proxy(tools: &Tools, at: &Namespace, folder: &std::path::Path, label: &str, number: usize) -> Result<Process> {
    let mut command = at.command(tools.gdp_proxy()?)?;
    command.arg("--config").arg(folder.join(label).join("proxy.yaml"));
    command.arg("--stats").arg(folder.join(label).join("stats.json"));
    Process::spawn(&format!("{label}-proxy-{number}"), command, folder)
}

/// A publisher of 6 MB once a second.
fn camera(tools: &Tools, at: &Namespace, folder: &std::path::Path, number: usize) -> Result<Process> {
    let options = ["talk", "--topic", "/large", "--size", "6000000", "--rate", "1"];
    rclpy(tools, at, folder, "rclpy_topic.py", &options, &format!("camera-{number}"))
}

/// A server (`switch`) or a client (`set`).
fn lamp(tools: &Tools, at: &Namespace, folder: &std::path::Path, verb: &str, number: usize) -> Result<Process> {
    rclpy(tools, at, folder, "rclpy_service.py", &[verb, "--service", "/lamp"], &format!("{verb}-{number}"))
}

fn rclpy(
    tools: &Tools,
    at: &Namespace,
    folder: &std::path::Path,
    script: &str,
    arguments: &[&str],
    label: &str,
) -> Result<Process> {
    let mut command = at.command(tools.python()?)?;
    command.arg(tools.peer(script)).args(arguments);
    command.env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4").env("ROS_DOMAIN_ID", "0").env("ROS_LOG_DIR", folder);
    Process::spawn(label, command, folder)
}

/// Nodes with one topic each, which come and go until the gate is there.
fn nodes(tools: &Tools, at: &Namespace, folder: &std::path::Path, verb: &str, seed: u64) -> Result<Process> {
    // The listeners are few, so that the talkers alone decide what there is to find.
    let each = if verb == "talk" { 1 } else { 10 };
    let mut command = at.command(tools.python()?)?;
    command.arg(tools.peer("any/churn.py")).args([verb, &NODES.to_string()]).arg(folder.join("gate"));
    command.args([each.to_string(), seed.to_string()]);
    Process::spawn(&format!("nodes-{verb}"), command, folder)
}
