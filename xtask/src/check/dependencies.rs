//! The rule on crates: forbidden dependencies, direct or indirect.

use anyhow::{Context, Result};

use crate::shell;

/// Crates, each with those that must not be among its dependencies with default features.
const FORBIDDEN: [(&str, &[&str]); 6] = [
    ("gdp-wire", &["tokio", "serde_json"]),
    ("gdp-core", &["tokio", "quinn", "rtnetlink"]),
    ("gdp-e2e", &["tokio", "quinn", "rtnetlink"]),
    ("gdp-rib", &["tokio", "quinn", "aya", "rtnetlink"]),
    ("gdp-proto", &["tokio", "quinn", "aya", "rtnetlink"]),
    ("gdp-proxy", &["aya", "etcd-client", "gdp-daemon", "gdp-dataplane"]),
];

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
