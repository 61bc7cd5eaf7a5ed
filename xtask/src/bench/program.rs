//! Builds the command line of a benchmark program.

use crate::setup::Purpose;
use crate::workspace::Profile;
use crate::{build, setup, shell, workspace};
use anyhow::{Result, bail};
use std::process::Command;

/// Passes the options for rounds, duration and output to a benchmark program.
pub fn pass(command: &mut Command, rounds: u32, milliseconds: u64, json: bool) {
    command.args(["--rounds", &rounds.to_string(), "--milliseconds", &milliseconds.to_string()]);
    if json {
        command.arg("--json");
    }
}

/// The rows to measure, and whether to draw them.
#[derive(clap::Args)]
pub struct Rows {
    /// Row of the figures to measure; repeat for several. An unknown row lists all
    #[arg(long, value_name = "ROW")]
    pub only: Vec<String>,
    /// Redraw the plots in docs/plots
    #[arg(long)]
    pub plots: bool,
}

impl Rows {
    pub fn pass(&self, command: &mut Command) {
        for row in &self.only {
            command.args(["--only", row]);
        }
        if self.plots {
            command.arg("--plots").arg(workspace::root().join("docs/plots"));
        }
    }
}

/// Returns the command of a bench target of `gdp-tests`, which runs as root in namespaces with the
/// XDP switch.
pub fn target(name: &str) -> Result<Command> {
    if !workspace::is_root() {
        bail!("network namespaces need root");
    }
    let mut command = unprivileged_target(name)?;
    build::ebpf()?;
    command.arg("--ebpf-object").arg(workspace::ebpf_object());
    Ok(command)
}

/// Returns the command of a bench target of `gdp-tests` that needs neither root nor the XDP switch.
pub fn unprivileged_target(name: &str) -> Result<Command> {
    setup::ensure(Purpose::Bench)?;
    let mut command = shell::cargo();
    command.args(["bench", "--profile", Profile::Dist.name(), "--workspace", "--bench", name, "--"]);
    Ok(command)
}
