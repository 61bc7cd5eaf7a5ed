//! Measures the path between two endpoints on the switch's own host: through the daemon, on packet
//! sockets, and by the pair of interfaces. It builds and runs a bench target of `gdp-tests`, which
//! has the eBPF loader and does the measurement.

use anyhow::Result;

use crate::shell;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Number of alternating measurements per path
    #[arg(long, default_value_t = 7)]
    rounds: u32,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 300)]
    milliseconds: u64,
}

pub fn run(options: Options) -> Result<()> {
    let mut command = super::program::target("local")?;
    super::program::pass(&mut command, options.rounds, options.milliseconds, options.json);
    shell::run(&mut command)
}
