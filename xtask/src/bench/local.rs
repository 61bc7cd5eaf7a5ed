//! From one endpoint to another on the switch's own host: through the daemon, on packet sockets, by
//! the pair of interfaces. The measurement itself is a bench target of `gdp-tests`, which has the
//! eBPF loader; here it is built and run.

use anyhow::Result;

use crate::shell;

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
    let mut command = super::program::target("local")?;
    super::program::pass(&mut command, options.rounds, options.milliseconds, options.json);
    shell::run(&mut command)
}
