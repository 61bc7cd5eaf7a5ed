//! `cargo xtask run`: builds a switch with XDP, then becomes `gdp-ctl serve`.

use std::os::unix::process::CommandExt;

use anyhow::{Context, Result};
use gdp_tests::programs::own;

use crate::build::{self, Executables, Features};
use crate::setup::{self, Purpose};
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    #[command(flatten)]
    features: Features,
    /// Arguments for `gdp-ctl serve`
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(Purpose::Run)?;
    options.features.ensure()?;
    build::executables(Executables::Switch, Profile::Release, options.features)?;
    let program = Profile::Release.executables().join("gdp-ctl");
    // Replaces this process, so that signals and the exit code are the daemon's own.
    let error = own(&program).arg("serve").args(options.arguments).exec();
    Err(error).with_context(|| format!("cannot start {}", program.display()))
}

#[cfg(test)]
#[path = "../tests/unit/run.rs"]
mod tests;
