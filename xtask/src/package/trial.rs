//! `cargo xtask package try`: installs, uses, upgrades and purges the packages in a clean Debian
//! root, in networks of its own:
//!
//! ```text
//!  root with the packages            far
//!  switch, XDP on e0 10.9.1.1 ────── f0 10.9.1.2 writer and reader
//! ```
//!
//! No systemd runs in the root. A script in the place of `systemctl` starts the `ExecStart=` of a
//! unit as the unit's user, with its capabilities and its bind mounts. `boot` has a real one.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};

use super::build::{Build, folder};
use super::deb;
use super::stage::{Staged, staged};
use crate::setup::{self, Purpose};
use crate::shell;
use crate::workspace::is_root;

const MIRROR: &str = "http://deb.debian.org/debian";

/// What runs in the root, and around it.
const SCRIPT: &str = include_str!("trial.sh");
const SYSTEMCTL: &str = include_str!("systemctl.sh");

pub fn run(build: &Build) -> Result<()> {
    anyhow::ensure!(is_root(), "a clean root is made with debootstrap and namespaces, which needs root");
    setup::ensure(Purpose::Fresh)?;
    let [old, new] = two_versions(build)?;
    let root = root("trial", "")?;
    let files = root.join("root");
    for (label, debs) in [("old", old), ("new", new)] {
        fs::create_dir_all(files.join(label))?;
        debs.iter().try_for_each(|deb| copy(deb, &files.join(label)))?;
    }
    fs::write(files.join("trial.sh"), SCRIPT)?;
    fs::write(files.join("systemctl.sh"), SYSTEMCTL)?;
    let mut command = Program::Unshare.command();
    command.args(["--mount", "--pid", "--fork", "--kill-child", "--uts", "--ipc", "--net", "--"]);
    command.args([Program::Sh.name(), "-eu"]).arg(files.join("trial.sh")).arg("outside").arg(&root);
    let result = shell::run(command.env("VERSIONS", format!("{}-1 {}-1", build.version, next(&build.version))));
    remove(&root)?;
    result.context("in the clean root")
}

/// Makes packages of this version and of a later one, from the same source.
pub fn two_versions(build: &Build) -> Result<[Vec<PathBuf>; 2]> {
    let old: Staged = staged(build)?;
    let old = deb::write(&old)?;
    let later = Build { version: next(&build.version), ..build.clone() };
    let new = deb::write(&staged(&later)?)?;
    Ok([old, new])
}

/// Returns the version after `version`.
fn next(version: &str) -> String {
    let (before, last) = version.rsplit_once('.').unwrap_or(("0.0", version));
    format!("{before}.{}", last.parse::<u32>().unwrap_or_default() + 1)
}

/// Makes a Debian root with further packages. A copy of it is kept for the next run.
pub fn root(label: &str, include: &str) -> Result<PathBuf> {
    let kept = folder().join(format!("root-{label}.tar"));
    let root = folder().join(format!("root-{label}"));
    remove(&root)?;
    if !kept.is_file() {
        let mut debootstrap = Program::Debootstrap.command();
        debootstrap.args([
            "--variant=minbase",
            &format!("--include=ethtool,iproute2,util-linux,procps{include}"),
            "bookworm",
        ]);
        let mut alone = Program::Unshare.command();
        alone.args(["--mount", "--pid", "--fork", "--kill-child", "--uts", "--ipc"]).arg(debootstrap.get_program());
        execute(alone.args(debootstrap.get_args()).arg(&root).arg(MIRROR))?;
        execute(Program::Tar.command().arg("-cf").arg(&kept).arg("-C").arg(&root).arg("."))?;
        return Ok(root);
    }
    fs::create_dir_all(&root)?;
    execute(Program::Tar.command().arg("-xf").arg(&kept).arg("-C").arg(&root))?;
    Ok(root)
}

pub fn copy(file: &Path, to: &Path) -> Result<()> {
    let name = file.file_name().context("a file has a name")?;
    fs::copy(file, to.join(name)).with_context(|| format!("cannot copy {}", file.display()))?;
    Ok(())
}

/// Removes a root. Mounts in it ended with the namespaces of the commands.
pub fn remove(root: &Path) -> Result<()> {
    match fs::remove_dir_all(root) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", root.display()))
        }
        _ => Ok(()),
    }
}
