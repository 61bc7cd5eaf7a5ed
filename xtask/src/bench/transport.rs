//! Messages from one program to another: this SDK beside QUIC and beside TLS over TCP. The
//! measurements themselves are a bench target of `gdp-tests`; here it is built and run.

use anyhow::Result;

use crate::shell;

#[derive(clap::Args)]
pub struct Options {
    /// One JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    rows: super::program::Rows,
    /// Whatever is compared is measured this often, in turn
    #[arg(long, default_value_t = 7)]
    rounds: u32,
    /// How long one measurement takes; those at a fixed rate take six times as long
    #[arg(long, default_value_t = 500)]
    milliseconds: u64,
}

pub fn run(options: Options) -> Result<()> {
    let mut command = super::program::target("transport")?;
    options.rows.pass(&mut command);
    super::program::pass(&mut command, options.rounds, options.milliseconds, options.json);
    shell::run(&mut command)
}
