//! Measures the control plane. It builds and runs a bench target of `gdp-tests`, which does the
//! measurements, and builds the daemons.

use anyhow::Result;

use crate::build::{self, Executables, Features};
use crate::shell;
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    rows: super::program::Rows,
    /// Number of alternating measurements per alternative
    #[arg(long, default_value_t = 3)]
    rounds: u32,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 500)]
    milliseconds: u64,
    /// Number of names in the large tables. A million names take some minutes to sign and verify
    #[arg(long, default_value_t = 1_000_000)]
    names: usize,
}

pub fn run(options: Options) -> Result<()> {
    let mut command = super::program::target("control")?;
    build::executables(Executables::All, Profile::Dist, Features::default())?;
    options.rows.pass(&mut command);
    command.args(["--names", &options.names.to_string()]);
    super::program::pass(&mut command, options.rounds, options.milliseconds, options.json);
    shell::run(&mut command)
}
