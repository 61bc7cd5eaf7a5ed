//! Clones the tree, and gives its files the times at which their content first appeared.

use std::collections::HashMap;
use std::fs::{self, File};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};

use crate::{shell, workspace};

/// Clones `HEAD` of the working copy, as from a remote.
pub fn clone(to: &Path) -> Result<()> {
    let root = workspace::root();
    let mut changed = Program::Git.command();
    changed.args(["status", "--porcelain", "--untracked-files=no"]).current_dir(root);
    if shell::output(&mut changed).is_none_or(|changed| !changed.is_empty()) {
        eprintln!("changes that are not committed are left out");
    }
    let mut clone = Program::Git.command();
    clone.args(["clone", "--quiet", "--no-hardlinks", "--"]).arg(root).arg(to);
    shell::say_and_run(&mut clone)?;
    let [here, there] = [root, to].map(head);
    ensure!(here? == there?, "{} is not a clone of HEAD", to.display());
    Ok(())
}

fn head(folder: &Path) -> Result<String> {
    execute(Program::Git.command().args(["rev-parse", "HEAD"]).current_dir(folder))
}

/// Sets the time of each file of the clone to when its content was first seen. So Cargo recognizes
/// which files have changed since the last run. `record` stores the times between runs.
pub fn restore_times(clone: &Path, record: &Path) -> Result<()> {
    // Without the record, all files are new.
    let before = fs::read_to_string(record).unwrap_or_default();
    let before: HashMap<&str, u64> = before
        .lines()
        .filter_map(|line| line.split_once(' '))
        .filter_map(|(t, key)| Some((key, t.parse().ok()?)))
        .collect();
    let now = SystemTime::now().duration_since(UNIX_EPOCH).context("the clock is before 1970")?.as_secs();
    let listed = execute(Program::Git.command().args(["ls-files", "--stage"]).current_dir(clone))?;
    let mut lines = String::new();
    for key in listed.lines() {
        // The format is `MODE HASH STAGE<tab>PATH`.
        let (_, path) = key.split_once('\t').with_context(|| format!("`git ls-files` says `{key}`"))?;
        let time = before.get(key).copied().unwrap_or(now);
        let file = clone.join(path);
        let set = File::open(&file).and_then(|file| file.set_modified(UNIX_EPOCH + Duration::from_secs(time)));
        set.with_context(|| format!("cannot set the time of {}", file.display()))?;
        lines.push_str(&format!("{time} {key}\n"));
    }
    fs::write(record, lines).with_context(|| format!("cannot write {}", record.display()))
}

#[cfg(test)]
#[path = "../../tests/unit/fresh/source.rs"]
mod tests;
