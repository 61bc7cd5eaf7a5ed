//! Measures the back ends of cryptography beside each other. It builds and runs a bench target of
//! `gdp-tests`, which does the measurements.

use anyhow::Result;

use crate::setup::{self, Purpose};
use crate::shell;
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    /// Row of the figures to measure; repeat for several. An unknown row lists all
    #[arg(long, value_name = "ROW")]
    only: Vec<String>,
    /// Number of alternating measurements per alternative
    #[arg(long, default_value_t = 7)]
    rounds: u32,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 100)]
    milliseconds: u64,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(Purpose::Bench)?;
    let mut command = shell::cargo();
    command.args(["bench", "--profile", Profile::Dist.name(), "--workspace", "--bench", "crypto", "--"]);
    for row in &options.only {
        command.args(["--only", row]);
    }
    super::program::pass(&mut command, options.rounds, options.milliseconds, options.json);
    shell::run(&mut command)
}
