//! What to pack, and where packages are.

use std::path::PathBuf;

use super::arch::Arch;
use crate::workspace;

/// The executables to pack.
#[derive(clap::Args, Clone)]
pub struct Build {
    /// Architecture of the packages
    #[arg(long, value_enum, default_value = "amd64")]
    pub arch: Arch,
    /// Version of the packages, if it is not that of the source
    #[arg(long, default_value = env!("CARGO_PKG_VERSION"))]
    pub version: String,
    /// Pack executables as the tests build them, with this machine's glibc: to test the packages
    #[arg(long)]
    pub checked: bool,
    /// Compile without link-time optimisation
    #[arg(long, conflicts_with = "checked")]
    pub quick: bool,
}

impl Build {
    /// Returns the folder of these packages. Those for tests never replace those to ship.
    pub fn folder(&self) -> PathBuf {
        if self.checked { folder().join("checked") } else { folder() }
    }
}

/// Returns the folder of packages to ship.
pub fn folder() -> PathBuf {
    workspace::target().join("package")
}

/// Returns the path of a file of the folder `packaging`.
pub fn packaging(file: &str) -> PathBuf {
    workspace::root().join("packaging").join(file)
}
