//! `cargo xtask bench NAME [--json]`: the figures in `docs/benchmarks`, one file a figure.
//!
//! What is compared is measured in one run under the same conditions, in turn, so that a busy machine slows both.

mod control;
mod forward;
mod latency;
mod local;
mod ros;
mod transport;

use std::process::Command;

use anyhow::{Result, bail};

use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};
use crate::{build, shell};

#[derive(clap::Args)]
pub struct Options {
    #[command(subcommand)]
    figure: Figure,
}

#[derive(clap::Subcommand)]
enum Figure {
    /// One-way latency, DDS to DDS: over three XDP switches, beside the same programs over three IP routers
    Latency(latency::Options),
    /// What forwarding costs: XDP beside a bare redirect, the kernel's IPv4 routers and a forwarder on packet sockets
    Forward(forward::Options),
    /// The control plane: statements and queries per second, memory per name, recovery after a cut, reconciliation
    Control(control::Options),
    /// From one endpoint to another on the switch's host: through the daemon, on packet sockets, past both
    Local(local::Options),
    /// ROS 2 messages through two proxies: latency and processor time, beside kernel routers and two zenoh bridges
    Ros(ros::Options),
    /// Throughput, CPU time and latency of messages: this SDK beside quinn and TLS over TCP
    Transport(transport::Options),
}

pub fn run(options: Options) -> Result<()> {
    match options.figure {
        Figure::Latency(options) => latency::run(options),
        Figure::Forward(options) => forward::run(options),
        Figure::Control(options) => control::run(options),
        Figure::Local(options) => local::run(options),
        Figure::Ros(options) => ros::run(options),
        Figure::Transport(options) => transport::run(options),
    }
}

/// How often and how long to measure, and how to show it.
fn pass(command: &mut Command, rounds: u32, milliseconds: u64, json: bool) {
    command.args(["--rounds", &rounds.to_string(), "--milliseconds", &milliseconds.to_string()]);
    if json {
        command.arg("--json");
    }
}

/// Which rows to measure, and whether to draw them.
#[derive(clap::Args)]
struct Rows {
    /// Only this row of the figures (can be given several times); an unknown one lists all
    #[arg(long, value_name = "ROW")]
    only: Vec<String>,
    /// Draw the plots in docs/plots anew
    #[arg(long)]
    plots: bool,
}

impl Rows {
    fn pass(&self, command: &mut Command) {
        for row in &self.only {
            command.args(["--only", row]);
        }
        if self.plots {
            command.arg("--plots").arg(workspace::root().join("docs/plots"));
        }
    }
}

/// A bench target of `gdp-tests`, which runs as root in namespaces and is given the XDP switch.
fn target(name: &str) -> Result<Command> {
    if !workspace::is_root() {
        bail!("network namespaces need root");
    }
    setup::ensure(Purpose::Bench)?;
    build::ebpf()?;
    let mut command = shell::cargo();
    command.args(["bench", "--profile", Profile::Dist.name(), "--workspace", "--bench", name, "--"]);
    command.arg("--ebpf-object").arg(workspace::ebpf_object());
    Ok(command)
}
