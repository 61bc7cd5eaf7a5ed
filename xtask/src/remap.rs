//! rustc's flags for what is shipped, so that it names no folder of the machine that compiles.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::workspace;

/// Returns the flags for `CARGO_ENCODED_RUSTFLAGS`. They replace those of the environment.
pub fn flags() -> Result<String> {
    Ok(of(workspace::root(), &workspace::target(), &cargo_home()?))
}

/// Returns Cargo's folder of registries.
fn cargo_home() -> Result<PathBuf> {
    if let Some(home) = std::env::var_os("CARGO_HOME") {
        return Ok(home.into());
    }
    Ok(std::env::home_dir().context("HOME is not set")?.join(".cargo"))
}

/// Cargo separates the flags by the character 31.
fn of(root: &Path, target: &Path, cargo_home: &Path) -> String {
    // The last prefix that matches counts.
    let folders = [(cargo_home, "/cargo"), (root, "/gdp"), (target, "/gdp/target")];
    let flag = |(from, to): (&Path, &str)| format!("--remap-path-prefix={}={to}", from.display());
    folders.map(flag).join("\u{1f}")
}

#[cfg(test)]
#[path = "../tests/unit/remap.rs"]
mod tests;
