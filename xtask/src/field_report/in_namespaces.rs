//! Edge and robot in two network namespaces of this machine, joined by a veth pair.

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::netns;
use gdp_tests::wait;

use super::echo;
use super::measure::{Effort, Robot};
use super::nic::Nic;
use super::report::mark;
use super::robot_file::RobotFile;
use super::serve::Edge;
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Run programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    checked: bool,
}

/// Runs what `serve` and `measure` run, and fails if a path carries nothing or the veth is not
/// marked.
pub fn run(options: &Options) -> Result<()> {
    if !workspace::is_root() {
        bail!("network namespaces need root: run `sudo cargo xtask field-report try`");
    }
    let tools = echo::prepare(if options.checked { Profile::Checked } else { Profile::Dist })?;
    wait::catch_interrupts();
    netns::sweep()?;
    let chain = Chain::build(ChainOptions { switches: 0, ..Default::default() })?;
    chain.become_ip_routers()?;
    let to = chain.ip_ends().1.parse().context("an address")?;
    let folder = tempfile::Builder::new().prefix("gdp-field-").tempdir().context("cannot create a folder")?;
    let nic = Nic::find(chain.cloud(), "l0")?;
    nic.check_address(to)?;
    let edge = Edge::start(&tools, chain.cloud(), nic, folder.path())?;
    let path = folder.path().join("robot.json");
    edge.robot_file()?.write(&path)?;
    let (file, nic) = (RobotFile::read(&path)?, Nic::towards(chain.robot(), to)?);
    let robot = Robot { tools: &tools, at: chain.robot(), nic, to, file };
    let report = robot.measure(&Effort::QUICK, folder.path()).with_context(|| edge.report())?;
    let text = report.to_string();
    print!("{text}");
    report.write(&folder.path().join("report.jsonl"))?;
    ensure!(report.is_whole(), "a path carried nothing, or other bytes than were sent");
    ensure!(text.contains(&mark("veth")), "the figures are not marked as those of a veth");
    Ok(())
}
