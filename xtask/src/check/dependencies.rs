//! The rules on dependencies: which crates must not depend on which, directly or indirectly, and
//! which crates are used in one folder only.

use std::collections::HashMap;
use std::path::PathBuf;

use anyhow::{Context, Result};

use super::sources::SourceFile;
use crate::shell;

/// Crates, each with those that must not be among its dependencies with default features.
const FORBIDDEN: [(&str, &[&str]); 6] = [
    ("gdp-wire", &["tokio", "serde_json"]),
    ("gdp-core", &["tokio", "quinn", "rtnetlink"]),
    ("gdp-e2e", &["tokio", "quinn", "rtnetlink"]),
    ("gdp-rib", &["tokio", "quinn", "aya", "rtnetlink"]),
    ("gdp-proto", &["tokio", "quinn", "aya", "rtnetlink"]),
    ("gdp-proxy", &["aya", "etcd-client", "gdp-daemon", "gdp-dataplane", "zenoh", "zenoh-ext"]),
];

/// Crates that are used in one folder, which is the interface to them.
const CONFINED: [(&str, &str); 2] = [("rustdds", "gdp-proxy/src/ros2"), ("ros2_client", "gdp-proxy/src/ros2")];

/// Returns the product files that use a confined crate outside of its folder.
pub fn outside(product: &HashMap<PathBuf, SourceFile>) -> Vec<String> {
    let uses = |source: &SourceFile, name: &str| {
        let is_part = |c: char| c.is_alphanumeric() || c == '_';
        let paths = source.text.match_indices(name).filter(|(at, _)| !source.text[..*at].ends_with(is_part));
        paths.map(|(at, _)| &source.text[at + name.len()..]).any(|rest| rest.starts_with("::"))
    };
    let outside = CONFINED.iter().flat_map(|(name, folder)| {
        let others = product.values().filter(move |source| !source.path.starts_with(folder));
        others.filter(|source| uses(source, name)).map(move |source| format!("{} uses {name}", source.path.display()))
    });
    let mut outside: Vec<String> = outside.collect();
    outside.sort();
    outside
}

pub fn findings() -> Result<Vec<String>> {
    let mut found = Vec::new();
    for (package, forbidden) in FORBIDDEN {
        let mut command = shell::cargo();
        command.args(["tree", "--package", package, "--edges", "normal", "--prefix", "none", "--format", "{p}"]);
        let output = command.output().context("cannot run `cargo tree`")?;
        if !output.status.success() {
            found.push(format!("{package}: {}", String::from_utf8_lossy(&output.stderr).trim()));
            continue;
        }
        let tree = String::from_utf8_lossy(&output.stdout).into_owned();
        let has = |name: &str| tree.lines().any(|line| line.split(' ').next() == Some(name));
        found.extend(forbidden.iter().filter(|name| has(name)).map(|name| format!("{package} depends on {name}")));
    }
    Ok(found)
}
