//! `cargo xtask deny`: checks licences, banned crates and sources of all dependencies.
//!
//! cargo-deny does it, by the `deny.toml` of each workspace or of the tree. Advisories are not
//! looked for: cargo-deny fetches them from GitHub, and they change without a change of the tree.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, ensure};
use gdp_tests::programs::own;

use crate::setup::{self, DENY_ENVIRONMENT, Purpose};
use crate::{git, shell, workspace};

/// The rules of the tree, for workspaces without rules of their own.
const RULES: &str = "deny.toml";

#[derive(clap::Args)]
pub struct Options {}

pub fn run(_: Options) -> Result<()> {
    setup::ensure(Purpose::Deny)?;
    let locks = git::tracked("*Cargo.lock")?;
    ensure!(!locks.is_empty(), "Git tracks no Cargo.lock under {}", workspace::root().display());
    for lock in locks {
        let folder = workspace::root().join(lock).with_file_name("");
        let own_rules = folder.join(RULES);
        let rules = if own_rules.is_file() { own_rules } else { workspace::root().join(RULES) };
        shell::say_and_run(&mut command(&folder, &rules))?;
    }
    Ok(())
}

/// Returns the command that checks the workspace of a folder by a file of rules.
fn command(folder: &Path, rules: &Path) -> Command {
    let mut command = own(program());
    command.args(["--workspace", "--locked", "--log-level", "error", "--manifest-path"]);
    command.arg(folder.join("Cargo.toml")).arg("--config").arg(rules);
    command.args(["check", "licenses", "bans", "sources"]);
    command
}

fn program() -> PathBuf {
    workspace::target().join(DENY_ENVIRONMENT).join("bin/cargo-deny")
}

#[cfg(test)]
#[path = "../tests/unit/deny.rs"]
mod tests;
