//! Measures messages between two programs: this SDK beside QUIC and beside TLS over TCP. It builds
//! and runs a bench target of `gdp-tests`, which does the measurements.

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
    /// Duration of a measurement, in milliseconds; measurements at a fixed rate take six times as
    /// long
    #[arg(long, default_value_t = 500)]
    milliseconds: u64,
}

pub fn run(options: Options) -> Result<()> {
    let mut command = super::program::target("transport")?;
    options.rows.pass(&mut command);
    super::program::pass(&mut command, options.rounds, options.milliseconds, options.json);
    shell::run(&mut command)
}
