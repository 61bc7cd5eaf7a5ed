//! `cargo xtask test --portable`: checks that the SDK compiles for Windows and macOS.
//!
//! Nothing is linked or run, so no C compiler and no SDK of these systems is needed. The build
//! script of AWS-LC, which would compile C, is replaced by what it tells Cargo.

use std::process::Command;

use anyhow::{Context, Result};

use crate::{shell, workspace};

/// The targets of rustc that the SDK is checked for.
pub const TARGETS: [&str; 2] = ["x86_64-pc-windows-gnu", "aarch64-apple-darwin"];

/// Returns the command that checks the SDK and all of this workspace that it depends on.
pub fn command() -> Result<Command> {
    let links = aws_lc_links()?;
    let mut command = shell::cargo();
    command.args(["clippy", "--profile", workspace::Profile::Checked.name(), "-p", "gdp", "--no-default-features"]);
    for target in TARGETS {
        let bindings = target.replace('-', "_");
        command.args(["--target", target]);
        command.args(["--config", &format!("target.{target}.{links}.include=\"nowhere\"")]);
        command.args(["--config", &format!("target.{target}.{links}.rustc-cfg=[\"{bindings}\"]")]);
    }
    command.args(["--", "-D", "warnings"]);
    Ok(command)
}

/// Returns the key `links` of the crate aws-lc-sys, which has its version: `aws_lc_0_47_0`.
fn aws_lc_links() -> Result<String> {
    let file = workspace::root().join("Cargo.lock");
    let lock = std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
    let version = lock.split_once("name = \"aws-lc-sys\"\nversion = \"").and_then(|(_, rest)| rest.split_once('"'));
    let (version, _) = version.context("Cargo.lock has no aws-lc-sys: adapt xtask/src/portable.rs")?;
    Ok(format!("aws_lc_{}", version.replace('.', "_")))
}
