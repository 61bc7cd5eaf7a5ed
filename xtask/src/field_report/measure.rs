//! The robot: asks the edge over plain DDS and over GDP in turn. Times are round trips by the
//! robot's clock, because two machines' clocks differ.

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::Tools;
use gdp_tests::chain::GDP_PORT;
use gdp_tests::netns::Namespace;
use gdp_tests::process::Process;
use gdp_tests::topics::FabricTopic;
use gdp_tests::wait::{self, check_interrupt, wait_for};
use serde_json::Value;

use super::echo::{self, EchoPath, PLAIN_PORTS, TOPICS};
use super::nic::{MachineFacts, Nic};
use super::report::{FieldReport, RoundTrips};
use super::robot_file::RobotFile;
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// The file that `field-report serve` wrote on the edge
    file: PathBuf,
    /// IPv4 address of the edge
    #[arg(long)]
    to: Ipv4Addr,
    /// Interface that leads to the edge. Default: that of the route
    #[arg(long)]
    interface: Option<String>,
    /// Measure two sizes once, with few messages
    #[arg(long)]
    quick: bool,
}

/// How much is measured.
pub struct Effort {
    sizes: &'static [usize],
    /// Requests of each size and path in a round.
    count: usize,
    rounds: usize,
}

impl Effort {
    pub const FULL: Self = Self { sizes: &[64, 8_000, 64_000, 1_000_000], count: 100, rounds: 2 };
    pub const QUICK: Self = Self { sizes: &[64, 64_000], count: 20, rounds: 1 };
}

/// Time for the proxy to attach to the switch.
const ATTACH: Duration = Duration::from_secs(10);

/// Time for discovery, and for a first round trip.
const MATCH: Duration = Duration::from_secs(20);

/// `robot.py` gives a request up after 10 s.
const LIMIT_EACH: Duration = Duration::from_secs(11);

pub fn run(options: &Options) -> Result<()> {
    let file = RobotFile::read(&options.file)?;
    let at = Namespace::here();
    let nic = match &options.interface {
        Some(name) => Nic::find(&at, name)?,
        None => Nic::towards(&at, options.to)?,
    };
    let tools = echo::prepare(Profile::Dist)?;
    wait::catch_interrupts();
    let effort = if options.quick { Effort::QUICK } else { Effort::FULL };
    let folder = echo::folder()?;
    let report = Robot { tools: &tools, at: &at, nic, to: options.to, file }.measure(&effort, &folder)?;
    print!("{report}");
    report.write(&folder.join("report.jsonl"))
}

/// A robot that knows an edge.
pub struct Robot<'a> {
    pub tools: &'a Tools,
    pub at: &'a Namespace,
    pub nic: Nic,
    pub to: Ipv4Addr,
    pub file: RobotFile,
}

impl Robot<'_> {
    /// Measures all sizes over both paths. Programs write into a new folder in `folder`.
    pub fn measure(self, effort: &Effort, folder: &Path) -> Result<FieldReport> {
        let files = tempfile::Builder::new().prefix("robot-").tempdir_in(folder).context("cannot create a folder")?;
        let mut proxy = self.start_proxy(files.path())?;
        let paths = [EchoPath::Plain { interface: &self.nic.name, peer: Some(self.to) }, EchoPath::Gdp];
        let runs: Vec<_> = effort.sizes.iter().flat_map(|bytes| paths.map(|path| (*bytes, path))).collect();
        let mut rows = Vec::new();
        for round in 0..effort.rounds {
            let mut order = runs.clone();
            if round % 2 == 1 {
                order.reverse();
            }
            for (bytes, path) in order {
                check_interrupt()?;
                proxy.check_alive()?;
                eprintln!("round {} of {}: {bytes} B, {}", round + 1, effort.rounds, path.name());
                rows.push(RoundTrips { bytes, round, ..self.ask(path, bytes, effort.count, files.path())? });
            }
        }
        let robot = MachineFacts::of(self.at, &self.nic)?;
        Ok(FieldReport { rows, robot, edge: self.file.edge, data_plane: self.file.data_plane })
    }

    /// Starts the proxy, and waits until it is attached to the edge's switch.
    fn start_proxy(&self, files: &Path) -> Result<Process> {
        let folder = files.join("robot");
        self.file.unpack(&folder)?;
        let topics = TOPICS.iter().map(|topic: &FabricTopic| topic.entry(topic.from_robot)).collect();
        let link = format!("udp://{}:{GDP_PORT}", self.to);
        let mut proxy = echo::start_proxy(self.tools, self.at, files, "robot", &link, topics)?;
        let switch = || {
            // The proxy writes it every second.
            let text = std::fs::read_to_string(folder.join("stats.json")).ok()?;
            let stats: Value = serde_json::from_str(&text).ok()?;
            Some(stats["switch"].as_str()?.to_owned())
        };
        let attached = wait_for("the edge's switch", ATTACH, || {
            proxy.check_alive()?;
            Ok(switch())
        });
        check_interrupt()?;
        let attached = attached.with_context(|| {
            format!(
                "no edge answers at {}, UDP port {GDP_PORT}: run `field-report serve` there, and open the port in \
                 firewalls",
                self.to
            )
        })?;
        ensure!(
            attached == self.file.switch,
            "the switch at {} is not the one that the file is from: copy the file again, each `serve` writes another",
            self.to
        );
        Ok(proxy)
    }

    /// Runs the robot's program once.
    fn ask(&self, path: EchoPath, bytes: usize, count: usize, folder: &Path) -> Result<RoundTrips> {
        let mut command = path.program(self.at, "robot.py")?;
        command.args(["--bytes", &bytes.to_string(), "--count", &count.to_string()]);
        let mut robot = Process::spawn(&format!("robot-{}", path.name()), command, folder)?;
        let matched = robot.wait_event("matched", MATCH);
        check_interrupt()?;
        matched.with_context(|| self.unmatched(path))?;
        // Reading its output meanwhile would take time from it.
        let limit = LIMIT_EACH * (count as u32 + 1);
        let status = wait_for("the last reply", limit, || robot.status()).with_context(|| robot.report())?;
        if !status.success() {
            bail!("the robot's program ended with {status}\n{}", robot.report());
        }
        Ok(round_trips(&robot.json_lines(), path, bytes))
    }

    /// Says what to do if a path carries nothing.
    fn unmatched(&self, path: EchoPath) -> String {
        match path {
            EchoPath::Plain { interface, .. } => format!(
                "plain DDS from `{interface}` gets no reply from {}: open UDP ports {}-{} in the firewalls of both",
                self.to,
                PLAIN_PORTS.start(),
                PLAIN_PORTS.end()
            ),
            EchoPath::Gdp => format!(
                "GDP gets no reply from {}: compare the clocks of both machines, since certificates are dated",
                self.to
            ),
        }
    }
}

/// Reads the events of `robot.py`.
fn round_trips(events: &[Value], path: EchoPath, bytes: usize) -> RoundTrips {
    let of = |event: &'static str| {
        let those = events.iter().filter(move |line| line["event"] == event);
        those.filter_map(|line| Some((line["id"].as_u64()?, line)))
    };
    let requests: BTreeMap<u64, &Value> = of("request").collect();
    let replies: Vec<(&Value, &Value)> =
        of("reply").filter_map(|(id, reply)| Some((*requests.get(&id)?, reply))).collect();
    let time = |(request, reply): &(&Value, &Value)| {
        reply["received"].as_u64()?.checked_sub(request["sent"].as_u64()?).map(Duration::from_nanos)
    };
    let mut times: Vec<Duration> = replies.iter().filter_map(time).collect();
    times.sort();
    RoundTrips {
        bytes,
        path: path.name(),
        round: 0,
        lost: requests.len() - times.len(),
        damaged: replies.iter().filter(|(request, reply)| request["digest"] != reply["digest"]).count(),
        times,
    }
}
