//! Messages from one program to another: this SDK beside QUIC and beside TLS over TCP. The measurements themselves are a bench target
//! of `gdp-tests`; here it is built and run.

use anyhow::{Result, bail};

use crate::setup::{self, Part};
use crate::workspace::{self, Profile};
use crate::{build, shell};

#[derive(clap::Args)]
pub struct Options {
    /// One JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    /// Only this row of the figures (can be given several times); an unknown one lists all
    #[arg(long, value_name = "ROW")]
    only: Vec<String>,
    /// Draw the plots in docs/plots anew
    #[arg(long)]
    plots: bool,
    /// Whatever is compared is measured this often, in turn
    #[arg(long, default_value_t = 7)]
    rounds: u32,
    /// How long one measurement takes; those at a fixed rate take six times as long
    #[arg(long, default_value_t = 500)]
    milliseconds: u64,
}

pub fn run(options: Options) -> Result<()> {
    if !workspace::is_root() {
        bail!("network namespaces need root");
    }
    setup::ensure(&[Part::Workspace, Part::Ebpf, Part::Namespaces])?;
    build::ebpf()?;
    let mut command = shell::cargo();
    command.args(["bench", "--profile", Profile::Release.name(), "--workspace", "--bench", "transport", "--"]);
    command.arg("--ebpf-object").arg(workspace::ebpf_object());
    command.args(["--rounds", &options.rounds.to_string(), "--milliseconds", &options.milliseconds.to_string()]);
    for row in &options.only {
        command.args(["--only", row]);
    }
    if options.plots {
        command.arg("--plots").arg(workspace::root().join("docs/plots"));
    }
    if options.json {
        command.arg("--json");
    }
    shell::run(&mut command)
}
