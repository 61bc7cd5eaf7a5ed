//! A fleet by one file: 20 robots are invited, join, and are revoked; the server is lost and comes
//! back from a backup.

use std::process::Command;

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::process::Process;
use gdp_tests::wait::TIMEOUT;
use serde_json::Value;

const ROBOTS: usize = 20;

#[test]
fn twenty_robots_join_by_one_file_and_outlive_the_loss_of_their_server() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.up()?;
    scene.fleet(&(1..=ROBOTS).collect::<Vec<_>>(), "/chatter")?;
    let shown = scene.apply(&[])?;
    ensure!(shown.iter().all(|row| row["done"] == false && row["line"].is_null()), "nothing is done: {shown:?}");
    let lines = scene.apply(&["--yes"])?;
    ensure!(lines.len() == ROBOTS && scene.apply(&[])?.is_empty(), "the same file makes no difference");

    // One command on each robot.
    for row in &lines {
        let (label, line) = (row["label"].as_str().context("a label")?, row["line"].as_str().context("a line")?);
        scene.join(label, line)?;
    }
    ensure!(scene.joined()? == ROBOTS, "all have joined");

    // One robot goes, and one shares another topic.
    scene.fleet(&(2..=ROBOTS).collect::<Vec<_>>(), "/odom")?;
    let changes = scene.apply(&["--yes"])?;
    let count = |change: &str| changes.iter().filter(|row| row["change"] == change).count();
    ensure!((count("revoke"), count("enroll"), count("invite")) == (1, ROBOTS - 1, 0), "{changes:?}");
    let robots = scene.robots()?;
    let row = |label: &str| robots.iter().find(|row| row["label"] == label).cloned().unwrap_or_default();
    ensure!(row("robot1")["state"] == "revoked" && row("robot2")["expose"][0] == "/odom", "{robots:?}");

    // One is revoked while the server is down. What was chosen for the first start holds later.
    scene.stop()?;
    scene.ctl(&["revoke", "robot3"])?;
    scene.start(&["up", "--no-ros"])?;
    scene.refuses("robot3")?;

    // The disk of the server is lost.
    scene.ctl(&["admin", "backup", &scene.path("home.gdp")])?;
    scene.stop()?;
    std::fs::remove_dir_all(scene.path("home"))?;
    let lost = scene.ctl(&["invite", "robot99", "--expose", "/a"]).unwrap_err().to_string();
    ensure!(lost.contains("gdp-ctl up"), "{lost}");
    scene.ctl(&["admin", "restore", &scene.path("home.gdp")])?;
    let again = scene.ctl(&["admin", "restore", &scene.path("home.gdp")]).unwrap_err().to_string();
    ensure!(again.contains("has a domain already"), "{again}");
    scene.up()?;
    ensure!(scene.joined()? == ROBOTS - 2, "they are members still");
    let mut robot = scene.run("robot2")?;
    robot.wait_until("the directory", TIMEOUT, |robot| robot.stderr().contains("what=directory").then_some(()))?;
    let log = scene.ctl(&["admin", "log"])?;
    for action in ["invite", "enroll", "revoke", "restore"] {
        ensure!(log.contains(action), "{action} is not in the log: {log}");
    }
    // A robot that was revoked before the backup stays so.
    scene.refuses("robot1")
}

/// As of a cloned SD card.
#[test]
fn one_key_in_two_programs_is_refused_to_the_later_one_with_the_address_of_the_other() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.up()?;
    let line = scene.ctl(&["invite", "robot7", "--expose", "/a"])?;
    scene.join("robot7", &line)?;
    std::fs::create_dir(scene.path("clone"))?;
    for file in std::fs::read_dir(scene.path("robot7"))? {
        let file = file?;
        std::fs::copy(file.path(), scene.files.path().join("clone").join(file.file_name()))?;
    }
    let start = |label: &str| scene.run(label);
    let is_attached = |proxy: &Process| proxy.stderr().contains("what=directory").then_some(());
    let mut first = start("robot7")?;
    first.wait_until("the directory", TIMEOUT, is_attached)?;
    let mut clone = start("clone")?;
    let says = "another program uses the key";
    clone.wait_until("a refusal", TIMEOUT, |clone| clone.stderr().contains(says).then_some(()))?;
    // Several attempts later.
    std::thread::sleep(std::time::Duration::from_secs(12));
    let count = |text: &str| text.lines().filter(|line| line.contains(says) || line.contains("no answer yet")).count();
    ensure!(clone.stderr().contains(", at udp:"), "{}", clone.stderr());
    ensure!(count(&clone.stderr()) <= 2, "{}", clone.stderr());
    let switch = scene.up.as_ref().context("the server")?.stderr();
    ensure!(count(&switch) <= 2, "{switch}");
    ensure!(!first.stderr().contains("WARN"), "the first one notices nothing: {}", first.stderr());

    // A program that dies without a word has a successor at once.
    first.kill()?;
    clone.wait_until("the directory", TIMEOUT, is_attached)?;
    clone.kill()?;
    start("robot7")?.wait_until("the directory", TIMEOUT, is_attached)
}

#[test]
fn errors_of_invite_join_and_apply_name_the_remedy() -> Result<()> {
    let mut scene = Scene::build()?;
    for (arguments, remedy) in [
        (vec!["invite", "robot7", "--expose", "/a"], "gdp-ctl up"),
        (vec!["robots"], "gdp-ctl up"),
        (vec!["admin", "log"], "nothing was issued"),
    ] {
        scene.refused(&arguments, remedy)?;
    }
    scene.up()?;
    for (arguments, remedy) in [
        (vec!["invite", "robot7"], "--expose '/camera/**'"),
        (vec!["invite", "Robot-7", "--expose", "/a"], "a-z, 0-9 and _"),
        (vec!["invite", "robot7", "--expose", "camera"], "leading slash"),
        (vec!["invite", "robot7", "--import", "/**"], "begin with a segment without *"),
        (vec!["invite", "robot7", "--read", "/camera"], "robot7:/camera/**"),
        (vec!["invite", "server", "--expose", "/a"], "choose another label"),
        (vec!["revoke", "robot7"], "gdp-ctl robots"),
        (vec!["apply", "-f", "/nowhere.yaml"], "cannot be read"),
    ] {
        scene.refused(&arguments, remedy)?;
    }
    let line = scene.ctl(&["invite", "robot7", "--expose", "/a"])?;
    let plain = scene.ctl(&[
        "domain",
        "invite",
        "--key",
        &scene.path("home/domain.pem"),
        "--role",
        "robot",
        "--at",
        "udp://127.0.0.1:31415",
    ])?;
    for (line, remedy) in [
        ("nonsense", "gdp-ctl"),
        (&line[..line.len() - 20], "copy the whole line"),
        (plain.trim(), "gdp-ctl domain join"),
    ] {
        let said = scene.join("robot7", line).unwrap_err().to_string();
        ensure!(said.contains(remedy), "{remedy} is not in: {said}");
    }
    scene.join("robot7", &line)?;
    let again = scene.join("robot7", &line).unwrap_err().to_string();
    ensure!(again.contains("gdp-proxy leave"), "{again}");
    Ok(())
}

/// A server and its robots on one machine. No robot has a ROS graph.
pub(super) struct Scene {
    // Fields drop in this order: programs, network, files.
    up: Option<Process>,
    pub server: Namespace,
    pub tools: Tools,
    pub files: tempfile::TempDir,
}

impl Scene {
    pub fn build() -> Result<Self> {
        let server = Namespace::create("server")?;
        Ok(Self { up: None, server, tools: Tools::beside_this_test()?, files: tempfile::tempdir()? })
    }

    pub fn path(&self, name: &str) -> String {
        self.files.path().join(name).display().to_string()
    }

    fn command(&self, arguments: &[&str]) -> Result<Command> {
        let mut command = self.server.command(self.tools.gdp_ctl()?)?;
        command.env("GDP_HOME", self.path("home")).env("GDP_SOCKET", self.path("ctl.sock")).args(arguments);
        Ok(command)
    }

    fn proxy(&self, arguments: &[&str]) -> Result<Command> {
        let mut command = self.server.command(self.tools.gdp_proxy()?)?;
        command.args(arguments);
        Ok(command)
    }

    pub fn up(&mut self) -> Result<()> {
        self.start(&["up", "--at", "127.0.0.1", "--no-ros"])
    }

    pub fn stop(&mut self) -> Result<()> {
        self.up.take().context("the server")?.stop(TIMEOUT).map(drop)
    }

    /// Waits until the switch tells a robot that it is revoked.
    pub fn refuses(&self, label: &str) -> Result<()> {
        self.refuses_for(label, "revo")
    }

    pub fn refuses_for(&self, label: &str, reason: &str) -> Result<()> {
        let mut robot = self.run(label)?;
        robot.wait_until("a refusal", TIMEOUT, |robot| robot.stderr().contains(reason).then_some(()))
    }

    /// Starts the proxy of a member.
    pub fn run(&self, label: &str) -> Result<Process> {
        let command = self.proxy(&["--config", &self.path(&format!("{label}/proxy.yaml"))])?;
        Process::spawn(label, command, self.files.path())
    }

    pub fn start(&mut self, arguments: &[&str]) -> Result<()> {
        let command = self.command(arguments)?;
        let mut up = Process::spawn("up", command, self.files.path())?;
        up.wait_until("the domain", TIMEOUT, |up| up.stdout().contains("Next").then_some(()))?;
        self.up = Some(up);
        Ok(())
    }

    pub fn ctl(&self, arguments: &[&str]) -> Result<String> {
        execute(&mut self.command(arguments)?)
    }

    #[track_caller]
    pub fn refused(&self, arguments: &[&str], remedy: &str) -> Result<()> {
        let said = self.ctl(arguments).err().map_or_else(String::new, |error| format!("{error:#}"));
        ensure!(said.contains(remedy), "{arguments:?}: {remedy} is not in: {said}");
        Ok(())
    }

    pub fn join(&self, label: &str, line: &str) -> Result<()> {
        let mut command = self.proxy(&["join", "--no-run", "--dir", &self.path(label)])?;
        execute(command.env("GDP_INVITATION", line)).map(drop)
    }

    /// Writes the file of the fleet.
    fn fleet(&self, robots: &[usize], topic: &str) -> Result<()> {
        let rows: String =
            robots.iter().map(|n| format!("  robot{n}: {{expose: [{topic}], import: [/cmd_vel]}}\n")).collect();
        Ok(std::fs::write(self.path("fleet.yaml"), format!("version: 1\nmembers:\n{rows}"))?)
    }

    fn apply(&self, options: &[&str]) -> Result<Vec<Value>> {
        let file = self.path("fleet.yaml");
        let said = self.ctl(&[&["-j", "apply", "-f", &file], options].concat())?;
        let rows = said.lines().map(serde_json::from_str).collect::<Result<Vec<Value>, _>>()?;
        Ok(rows.into_iter().filter(|row| row.get("label").is_some()).collect())
    }

    pub fn robots(&self) -> Result<Vec<Value>> {
        let robots: Value = serde_json::from_str(&self.ctl(&["-j", "robots"])?)?;
        robots["members"].as_array().cloned().context("a list")
    }

    /// Returns the number of members that have joined.
    pub fn joined(&self) -> Result<usize> {
        Ok(self
            .robots()?
            .iter()
            .filter(|row| ["online", "offline"].iter().any(|state| row["state"] == **state))
            .count())
    }
}
