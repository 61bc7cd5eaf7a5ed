//! Makes the packages of another revision of this repository, and unpacks them.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};

use crate::fresh::source::clone;
use crate::{shell, workspace};

/// Makes the packages of a revision with that revision's `cargo xtask package`, in a clone and a
/// target folder of their own. Returns the folder of the executables in them.
pub fn executables(revision: &str) -> Result<PathBuf> {
    let folder = workspace::target().join("previous");
    let (source, target, unpacked) = (folder.join("source"), folder.join("target"), folder.join("unpacked"));
    for old in [&source, &unpacked] {
        if old.exists() {
            fs::remove_dir_all(old).with_context(|| format!("cannot remove {}", old.display()))?;
        }
    }
    let wanted = format!("{revision}^{{commit}}");
    let mut parse = Program::Git.command();
    let commit =
        execute(parse.args(["rev-parse", "--verify", "--end-of-options", &wanted]).current_dir(workspace::root()))?;
    clone(&source)?;
    execute(Program::Git.command().args(["checkout", "--quiet", "--detach", commit.trim()]).current_dir(&source))?;
    let mut package = shell::cargo();
    package.args(["run", "--quiet", "--package", "xtask", "--", "package", "--deb", "--checked"]);
    shell::say_and_run(package.current_dir(&source).env("CARGO_TARGET_DIR", &target))?;
    let made = target.join("package/checked");
    let debs = fs::read_dir(&made).with_context(|| format!("{revision} has no packages in {}", made.display()))?;
    for deb in debs.flatten().map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|it| it == "deb")) {
        execute(Program::DpkgDeb.command().arg("-x").arg(deb).arg(&unpacked))?;
    }
    let executables = unpacked.join("usr/bin");
    ensure!(executables.join("gdp-ctl").is_file(), "the packages of {revision} have no gdp-ctl");
    eprintln!("from the packages of {commit}");
    Ok(executables)
}
