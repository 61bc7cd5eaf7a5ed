//! What Git knows of the working copy.

use std::path::PathBuf;

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program};

use crate::{shell, workspace};

/// Returns the files that Git tracks and that match `pattern`, relative to the workspace's root.
/// Skips deleted files.
pub fn tracked(pattern: &str) -> Result<Vec<PathBuf>> {
    let mut git = Program::Git.command();
    git.args(["ls-files", pattern]).current_dir(workspace::root());
    let listed = shell::output(&mut git).context("`git ls-files` failed")?;
    Ok(listed.lines().map(PathBuf::from).filter(|path| workspace::root().join(path).is_file()).collect())
}
