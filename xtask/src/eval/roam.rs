//! The drone of the paper's Figure 1: it moves from an enterprise's network to a university's while
//! vSLAM runs in the cloud. ROS 2 sends its images, and ROS 1 in the cloud sends its commands. Both
//! ends are behind NAT in either network.

use std::collections::BTreeSet;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use anyhow::{Context as _, Result, bail, ensure};
use gdp_tests::federation::{Federation, Site as Place};
use gdp_tests::peers::{self, ON_LOOPBACK, Received};
use gdp_tests::process::Process;
use gdp_tests::programs::Program;
use gdp_tests::topics::{FabricTopic, MASTER};
use gdp_tests::wait::{self, wait_for};
use serde::Serialize;
use serde_json::json;

use super::links::LinkKind;
use super::raw;
use super::site::{Network, Setup, Site};
use super::tools::EvalTools;
use super::trial::{Requests, RunningWorkload, Trial, monotonic, slowest_since};
use super::workload::Workload;
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object a row on stdout instead of tables
    #[arg(long)]
    pub json: bool,
    /// Move once instead of four times
    #[arg(long)]
    pub quick: bool,
    /// Run programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    pub checked: bool,
}

/// Commands per second.
const COMMAND_RATE: f64 = 20.0;

/// The port of the cloud's [`MASTER`].
const MASTER_PORT: u16 = 11311;

/// Time in each network.
const STAY: Duration = Duration::from_secs(6);

const COMMANDS: FabricTopic =
    FabricTopic { topic: "/commands", kind: "std_msgs/msg/String", from_robot: false, in_ros1: true };

/// What a move did.
#[derive(Serialize)]
struct MoveRow {
    to: &'static str,
    /// The longest time that an image took to the cloud since the move began, in milliseconds.
    slowest_image_ms: f64,
    /// The longest time that a command took to the robot, in milliseconds.
    slowest_command_ms: f64,
}

pub fn run(options: &Options) -> Result<()> {
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    let tools = EvalTools::prepare(profile, false)?;
    let folder = tempfile::Builder::new().prefix("gdp-eval-").tempdir().context("cannot create a folder")?;
    let folder = folder.path();
    let topics: Vec<FabricTopic> = Workload::Slam.topics().iter().copied().chain([COMMANDS]).collect();
    let mut site = Site::start(&tools, Setup::Domains, &LinkKind::Plain.cables(), &topics, folder)?;
    let moves = if options.quick { 1 } else { 4 };
    let seconds = STAY.as_secs_f64() * f64::from(moves + 1) + 2.0;
    let requests = Requests::for_seconds(seconds, options.quick);
    let mut pilot = Pilot::start(&tools, federation(&mut site)?, folder)?;
    let running = RunningWorkload::start(&tools, &site, Workload::Slam, requests, folder)?;
    pilot.steer(folder)?;
    wait::sleep(STAY)?;
    let mut rows = Vec::new();
    for i in 0..moves {
        let place = if i % 2 == 0 { Place::University } else { Place::Enterprise };
        let (since, before) = (monotonic()?, pilot.received().len());
        federation(&mut site)?.roam(place)?;
        wait::sleep(STAY)?;
        let slowest_image = slowest_since(&running.exchanges(), since)?;
        let slowest_command = pilot.received().iter().skip(before).map(|it| it.latency).max().unwrap_or(STAY);
        let to = if place == Place::University { "the university's" } else { "the enterprise's" };
        rows.push(MoveRow {
            to,
            slowest_image_ms: milliseconds(slowest_image),
            slowest_command_ms: milliseconds(slowest_command),
        });
    }
    let trial = running.finish(&site)?;
    let commands = pilot.finish()?;
    let expected = commands.last().map_or(0, |last| *last as usize + 1);
    let lost = expected - commands.len();
    let summary = json!({"commands": commands.len(), "commands_lost": lost, "trial": trial});
    raw::write_all("roam", &rows, &summary, options.json)?;
    if !options.json {
        print(&rows, &trial, commands.len(), lost);
    }
    ensure!(lost == 0, "{lost} commands were lost");
    trial.check(Workload::Slam)
}

fn print(rows: &[MoveRow], trial: &Trial, commands: usize, lost: usize) {
    println!("| the robot moves to | slowest image | slowest command |\n|{}", " --- |".repeat(3));
    for MoveRow { to, slowest_image_ms, slowest_command_ms } in rows {
        println!("| {to} network | {slowest_image_ms:.0} ms | {slowest_command_ms:.0} ms |");
    }
    println!(
        "{} of {} images answered, {} damaged; {commands} commands, {lost} lost; {}",
        trial.requests - trial.lost,
        trial.requests,
        trial.damaged,
        Workload::Slam.result(&trial.result)
    );
}

fn federation(site: &mut Site) -> Result<&mut Federation> {
    match &mut site.network {
        Network::Federation(federation) => Ok(federation),
        _ => bail!("not a federation"),
    }
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// A ROS 1 master and a rospy node in the cloud that sends commands, and a ROS 2 node on the robot
/// that receives them.
struct Pilot {
    listener: Process,
    _talker: Process,
    _master: Process,
}

impl Pilot {
    fn start(tools: &EvalTools, federation: &Federation, folder: &Path) -> Result<Self> {
        let in_ros1 = |arguments: &[&str]| -> Result<Command> {
            let mut command = federation.cloud.command(Program::Python3)?;
            command.args(arguments).env("ROS_MASTER_URI", MASTER).env("ROS_HOSTNAME", "localhost");
            command.env("ROS_LOG_DIR", folder);
            Ok(command)
        };
        let master = Process::spawn(
            "rosmaster",
            in_ros1(&[Program::Rosmaster.name(), "--core", "-p", &MASTER_PORT.to_string()])?,
            folder,
        )?;
        wait_for("the ROS 1 master", wait::TIMEOUT, || {
            let _inside = federation.cloud.enter()?;
            Ok(TcpStream::connect(("127.0.0.1", MASTER_PORT)).ok().map(drop))
        })
        .with_context(|| master.report())?;
        let peer = tools.tools.peer("rospy_topic.py");
        let mut talk = in_ros1(&[])?;
        talk.arg(peer).args(["talk", "--topic", COMMANDS.topic, "--rate", &COMMAND_RATE.to_string()]);
        talk.arg("--gate").arg(gate(folder));
        let mut listen = federation.robot.command(tools.tools.python()?)?;
        listen.arg(tools.tools.cyclone()).args(["listen", "--topic", "rt/commands", "--depth", "100"]);
        listen.env("CYCLONEDDS_URI", ON_LOOPBACK);
        let mut listener = Process::spawn("commands-received", listen, folder)?;
        let talker = Process::spawn("commands-sent", talk, folder)?;
        let came = |p: &Process| p.json_lines().iter().any(|line| line["event"] == "message").then_some(());
        listener.wait_until("a first command", wait::TIMEOUT, came).with_context(|| talker.report())?;
        Ok(Self { listener, _talker: talker, _master: master })
    }

    /// Lets the commands count from now on.
    fn steer(&mut self, folder: &Path) -> Result<()> {
        let gate = gate(folder);
        std::fs::write(&gate, "").with_context(|| format!("cannot write {}", gate.display()))
    }

    /// Waits for further commands, and returns the numbers of all, each once.
    fn finish(&mut self) -> Result<BTreeSet<i64>> {
        let so_far = self.received().len();
        let further = |p: &Process| (peers::received(p).len() > so_far + 5).then_some(());
        self.listener.wait_until("further commands", wait::TIMEOUT, further)?;
        Ok(self.received().iter().map(|command| command.sequence).collect())
    }

    fn received(&self) -> Vec<Received> {
        peers::received(&self.listener)
    }
}

fn gate(folder: &Path) -> PathBuf {
    folder.join("commands-gate")
}
