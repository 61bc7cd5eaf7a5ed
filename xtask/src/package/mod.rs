//! `cargo xtask package`: Debian packages, a tar and an image of the OCI, for amd64 and arm64.
//!
//! [`compile`] makes the executables for an old glibc. [`stage`] lays out the files of each
//! package, with [`manuals`] and bills of materials ([`sbom`]). [`deb`], [`tar`] and [`image`]
//! write them into one file each. Equal executables make equal files.
//! [`units`] checks the units. `try` installs the packages in a clean Debian root, `boot` in a
//! virtual machine. `rolling-upgrade` upgrades switches one by one from another revision's package.

mod arch;
mod boot;
mod build;
mod changelog;
mod compile;
mod deb;
mod image;
mod manuals;
mod previous;
mod sbom;
mod stage;
mod tar;
mod trial;
mod units;

use anyhow::Result;

use self::arch::Arch;
use self::build::Build;
use crate::setup::{self, Purpose};
use crate::test;

#[derive(clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Options {
    #[command(subcommand)]
    action: Option<PackageAction>,
    /// Make Debian packages, and check them with lintian
    #[arg(long)]
    deb: bool,
    /// Make a tar of all files, for other distributions
    #[arg(long)]
    tar: bool,
    /// Make an image of the OCI with gdp-proxy and gdp-ctl, and start them in it (needs root)
    #[arg(long)]
    image: bool,
    #[command(flatten)]
    build: Build,
}

#[derive(clap::Subcommand)]
enum PackageAction {
    /// Install, use, upgrade and purge the packages in a clean Debian root (needs root)
    Try(Build),
    /// Boot the packages in a virtual machine with systemd (needs root)
    Boot(Build),
    /// Upgrade a chain of switches one by one, under traffic, from the package of another revision
    /// to this source (needs root)
    RollingUpgrade {
        /// The revision, in the words of git
        #[arg(long, value_name = "REVISION")]
        from: String,
    },
    /// Check the units: their syntax, and how much of the system they can reach
    Units,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(Purpose::Package)?;
    match options.action {
        Some(PackageAction::Try(build)) => return trial::run(&build),
        Some(PackageAction::Boot(build)) => return boot::run(&build),
        Some(PackageAction::RollingUpgrade { from }) => return test::rolling_upgrade(previous::executables(&from)?),
        Some(PackageAction::Units) => return units::check(),
        None => {}
    }
    if options.build.arch == Arch::Arm64 {
        setup::ensure(Purpose::Arm64)?;
    }
    units::check()?;
    let all = !(options.deb || options.tar || options.image);
    let staged = stage::staged(&options.build)?;
    if options.deb || all {
        let debs = deb::write(&staged)?;
        deb::check(&debs)?;
    }
    if options.tar || all {
        tar::write(&staged)?;
    }
    if options.image || all {
        image::check(&image::write(&staged)?, options.build.arch)?;
    }
    Ok(())
}
