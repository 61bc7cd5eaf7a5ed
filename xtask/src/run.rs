//! `cargo xtask run`: builds, then becomes `gdp-ctl serve`. Root gets the kernel data plane, others the userspace one.

use std::os::unix::process::CommandExt;
use std::process::Command;

use anyhow::{Context, Result};

use crate::build;
use crate::setup::{self, Part};
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Builds the DPDK data plane as well, for a configuration with `data_plane: dpdk`
    #[arg(long)]
    dpdk: bool,
    /// Passed on to `gdp-ctl serve`
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(&[Part::Workspace])?;
    if options.dpdk {
        setup::ensure(&[Part::Dpdk])?;
    }
    if workspace::is_root() {
        setup::ensure(&[Part::Ebpf])?;
        build::all(Profile::Release, options.dpdk)?;
    } else if setup::has(Part::Ebpf) {
        build::all(Profile::Release, options.dpdk)?;
    } else {
        eprintln!("Not root: the userspace data plane will be used, so the XDP programs are not built.");
        build::executables(Profile::Release, options.dpdk)?;
    }
    let program = Profile::Release.executables().join("gdp-ctl");
    // Replaces this process, so that signals and the exit code are the daemon's own.
    let error = Command::new(&program).arg("serve").args(options.arguments).exec();
    Err(error).with_context(|| format!("cannot start {}", program.display()))
}
