//! What Git knows of the working copy.

use std::path::PathBuf;

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program};

use crate::{shell, workspace};

/// Returns the time of the current commit, in seconds since 1970.
pub fn commit_time() -> Result<u64> {
    let mut git = Program::Git.command();
    git.args(["log", "-1", "--format=%ct"]).current_dir(workspace::root());
    let time = shell::output(&mut git).context("`git log` failed")?;
    time.parse().with_context(|| format!("`git log` wrote {time:?} as a time"))
}

/// Returns the files that Git tracks and that match `pattern`, relative to the workspace's root.
/// Skips deleted files.
pub fn tracked(pattern: &str) -> Result<Vec<PathBuf>> {
    let mut git = Program::Git.command();
    git.args(["ls-files", pattern]).current_dir(workspace::root());
    let listed = shell::output(&mut git).context("`git ls-files` failed")?;
    Ok(listed.lines().map(PathBuf::from).filter(|path| workspace::root().join(path).is_file()).collect())
}
