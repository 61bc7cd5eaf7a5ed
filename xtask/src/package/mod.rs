//! `cargo xtask package`: Debian packages, a tar and an image of the OCI, for amd64 and arm64.
//!
//! [`compile`] makes the executables for an old glibc. [`stage`] lays out the files of each package,
//! with [`manuals`]. [`deb`], [`tar`] and [`image`] write them into one file each. [`units`] checks
//! the units of systemd. `try` installs the packages in a clean Debian root, `boot` in a virtual
//! machine.

mod arch;
mod boot;
mod changelog;
mod compile;
mod deb;
mod image;
mod manuals;
mod stage;
mod tar;
mod trial;
mod units;

use std::path::PathBuf;

use anyhow::Result;

pub use self::arch::Arch;
use self::stage::Staged;
use crate::setup::{self, Purpose};
use crate::workspace;

#[derive(clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Options {
    #[command(subcommand)]
    action: Option<Action>,
    /// Make Debian packages, and check them with lintian
    #[arg(long)]
    deb: bool,
    /// Make a tar of all files, for other distributions
    #[arg(long)]
    tar: bool,
    /// Make an image of the OCI with gdp-proxy and gdp-ctl (amd64 only)
    #[arg(long)]
    image: bool,
    #[command(flatten)]
    build: Build,
}

/// The executables to pack.
#[derive(clap::Args, Clone)]
pub struct Build {
    /// Architecture of the packages
    #[arg(long, value_enum, default_value = "amd64")]
    arch: Arch,
    /// Version of the packages, if it is not that of the source
    #[arg(long, default_value = env!("CARGO_PKG_VERSION"))]
    version: String,
    /// Pack executables as the tests build them, with this machine's glibc: to test the packages
    #[arg(long)]
    checked: bool,
    /// Compile without link-time optimisation
    #[arg(long, conflicts_with = "checked")]
    quick: bool,
}

#[derive(clap::Subcommand)]
enum Action {
    /// Install, use, upgrade and purge the packages in a clean Debian root (needs root)
    Try(Build),
    /// Boot the packages in a virtual machine with systemd (needs root)
    Boot(Build),
    /// Check the units: their syntax, and how much of the system they can reach
    Units,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(Purpose::Package)?;
    match options.action {
        Some(Action::Try(build)) => return trial::run(&build),
        Some(Action::Boot(build)) => return boot::run(&build),
        Some(Action::Units) => return units::check(),
        None => {}
    }
    units::check()?;
    let all = !(options.deb || options.tar || options.image);
    let staged = staged(&options.build)?;
    if options.deb || all {
        let debs = deb::write(&staged)?;
        deb::check(&debs)?;
    }
    if options.tar || all {
        tar::write(&staged)?;
    }
    if options.image || all && options.build.arch == Arch::Amd64 {
        image::write(&staged)?;
    }
    Ok(())
}

/// Compiles, and lays out the files of all packages.
fn staged(build: &Build) -> Result<Staged> {
    let executables = compile::executables(build)?;
    stage::lay_out(build, &executables)
}

/// Returns the folder of packages.
fn folder() -> PathBuf {
    workspace::target().join("package")
}
