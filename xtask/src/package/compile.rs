//! Compiles the executables of packages. With zig as C compiler and linker they need only the
//! symbols of an old glibc, so they run on Ubuntu 20.04, Debian 11 and JetPack 5 and later.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::programs::{Executable as _, Program};

use super::build::Build;
use crate::setup::{self, Purpose, ZIG_ENVIRONMENT};
use crate::workspace::{self, FEATURES, Profile};
use crate::{build, remap, shell};

/// The glibc that executables may need at most.
const GLIBC: (u32, u32) = (2, 31);

/// The executables of packages. They may have symbols.
pub struct Executables {
    pub ctl: PathBuf,
    pub proxy: PathBuf,
    /// The glibc that they need.
    pub glibc: (u32, u32),
}

pub fn executables(options: &Build) -> Result<Executables> {
    if options.checked {
        ensure!(options.arch.is_native(), "--checked packs executables of this machine's architecture");
        build::executables(build::Executables::All, Profile::Checked, build::Features::default())?;
        return Executables::of(&Profile::Checked.executables());
    }
    setup::ensure(Purpose::Release)?;
    build::ebpf()?;
    let profile = if options.quick { Profile::Release } else { Profile::Dist };
    let target = options.arch.target();
    let (major, minor) = GLIBC;
    let mut command = shell::cargo();
    command.args(["zigbuild", "--profile", profile.name(), "--target", &format!("{target}.{major}.{minor}")]);
    command.args([
        "-p",
        "gdp-ctl",
        "-p",
        "gdp-proxy",
        "--features",
        FEATURES,
        "--bin",
        "gdp-ctl",
        "--bin",
        "gdp-proxy",
    ]);
    command.env("CARGO_ENCODED_RUSTFLAGS", remap::flags()?);
    let own = workspace::target().join(ZIG_ENVIRONMENT).join("bin");
    let paths = std::env::var_os("PATH").unwrap_or_default();
    let paths = std::env::join_paths(std::iter::once(own).chain(std::env::split_paths(&paths)));
    command.env("PATH", paths.context("the target folder has a colon in its path")?);
    shell::say_and_run(&mut command)?;
    let built = Executables::of(&workspace::target().join(target).join(profile.name()))?;
    ensure!(built.glibc <= GLIBC, "the executables may need glibc {}.{} at most", GLIBC.0, GLIBC.1);
    Ok(built)
}

impl Executables {
    fn of(folder: &Path) -> Result<Self> {
        let (ctl, proxy) = (folder.join("gdp-ctl"), folder.join("gdp-proxy"));
        let glibc = needed_glibc(&ctl)?.max(needed_glibc(&proxy)?);
        Ok(Self { ctl, proxy, glibc })
    }
}

/// Returns the glibc that an executable needs. `readelf` reads those of every architecture.
fn needed_glibc(executable: &Path) -> Result<(u32, u32)> {
    let mut readelf = Program::Readelf.command();
    let listed = shell::output(readelf.args(["--wide", "--dyn-syms"]).arg(executable));
    let listed = listed.with_context(|| format!("{} has no dynamic symbols", executable.display()))?;
    let Some((newest, symbol)) = newest_glibc(&listed) else {
        bail!("{} needs no glibc, so its symbols cannot be compared", executable.display())
    };
    let (major, minor) = newest;
    eprintln!("{}: glibc {major}.{minor} or later, for `{symbol}`", executable.display());
    Ok(newest)
}

/// Returns the newest version of glibc in a list of symbols, and a symbol that needs it.
fn newest_glibc(symbols: &str) -> Option<((u32, u32), &str)> {
    let versions = symbols.split_whitespace().filter_map(|word| {
        let (symbol, version) = word.split_once("@GLIBC_")?;
        let mut numbers = version.split('.').map_while(|number| number.parse().ok());
        Some(((numbers.next()?, numbers.next()?), symbol))
    });
    versions.max_by_key(|(version, _)| *version)
}

#[cfg(test)]
#[path = "../../tests/unit/package/compile.rs"]
mod tests;
