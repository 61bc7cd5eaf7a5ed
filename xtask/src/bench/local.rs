//! From one endpoint to another on the switch's own host: through the daemon, on packet sockets, by the pair of interfaces. The
//! measurement itself is a bench target of `gdp-tests`, which has the eBPF loader; here it is built and run.

use anyhow::{Result, bail};

use crate::setup::{self, Part};
use crate::workspace::{self, Profile};
use crate::{build, shell};

#[derive(clap::Args)]
pub struct Options {
    /// One JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Each way is measured this often, in turn
    #[arg(long, default_value_t = 7)]
    rounds: u32,
    /// How long one measurement takes
    #[arg(long, default_value_t = 300)]
    milliseconds: u64,
}

pub fn run(options: Options) -> Result<()> {
    if !workspace::is_root() {
        bail!("network namespaces need root");
    }
    setup::ensure(&[Part::Workspace, Part::Ebpf, Part::Namespaces])?;
    build::ebpf()?;
    let mut command = shell::cargo();
    command.args(["bench", "--profile", Profile::Release.name(), "--workspace", "--bench", "local", "--"]);
    command.arg("--ebpf-object").arg(workspace::ebpf_object());
    command.args(["--rounds", &options.rounds.to_string(), "--milliseconds", &options.milliseconds.to_string()]);
    if options.json {
        command.arg("--json");
    }
    shell::run(&mut command)
}
