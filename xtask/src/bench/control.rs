//! What the control plane does. The measurements themselves are a bench target of `gdp-tests`; here
//! it and the daemons are built, and it is run.

use anyhow::Result;

use crate::build::{self, Executables, Features};
use crate::shell;
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// One JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    rows: super::program::Rows,
    /// Whatever is compared is measured this often, in turn
    #[arg(long, default_value_t = 3)]
    rounds: u32,
    /// How long one measurement takes
    #[arg(long, default_value_t = 500)]
    milliseconds: u64,
    /// Names where there are many; a million take some minutes to be signed and verified
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
