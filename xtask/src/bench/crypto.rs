//! Measures the back ends of cryptography beside each other. It builds and runs a bench target of
//! `gdp-tests`, which does the measurements.

use anyhow::Result;

use crate::shell;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    rows: super::program::Rows,
    /// Number of alternating measurements per alternative
    #[arg(long, default_value_t = 7)]
    rounds: u32,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 100)]
    milliseconds: u64,
}

pub fn run(options: Options) -> Result<()> {
    let mut command = super::program::unprivileged_target("crypto")?;
    options.rows.pass(&mut command);
    super::program::pass(&mut command, options.rounds, options.milliseconds, options.json);
    shell::run(&mut command)
}
