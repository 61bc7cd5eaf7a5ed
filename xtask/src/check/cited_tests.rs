//! The rule on tests that documents name: they exist.

use std::collections::BTreeSet;
use std::fs;

use anyhow::{Context, Result};

use crate::git::tracked;
use crate::workspace;

/// The documents whose claims rest on tests that they name.
const DOCUMENTS: [&str; 2] = ["docs/security.md", "docs/reliability.md"];

/// The most lines between the attribute of a test and its function.
const BETWEEN: usize = 4;

/// Returns the names in the documents that are no test's.
pub fn missing() -> Result<Vec<String>> {
    let mut tests = BTreeSet::new();
    for path in tracked("*.rs")? {
        let text = read(&path.to_string_lossy())?;
        tests.extend(names_of_tests(&text));
    }
    let mut found = Vec::new();
    for document in DOCUMENTS {
        let text = read(document)?;
        found.extend(unknown(&text, &tests).into_iter().map(|name| format!("{document} names {name}")));
    }
    Ok(found)
}

fn read(path: &str) -> Result<String> {
    let file = workspace::root().join(path);
    fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))
}

fn names_of_tests(text: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    let mut since_attribute = usize::MAX;
    for line in text.lines().map(str::trim_start) {
        let is_attribute = ["#[test]", "#[tokio::test"].iter().any(|a| line.starts_with(a));
        since_attribute = if is_attribute { 0 } else { since_attribute.saturating_add(1) };
        let function = line.trim_start_matches("async ").strip_prefix("fn ");
        if let Some(function) = function.filter(|_| since_attribute <= BETWEEN) {
            names.extend(function.split(['(', '<']).next().map(str::to_owned));
            since_attribute = usize::MAX;
        }
    }
    names
}

/// Returns the words in backticks that look like functions and are none of the tests. A name may
/// end with `…`. Paths, commands and types are skipped.
fn unknown(document: &str, tests: &BTreeSet<String>) -> Vec<String> {
    let quoted = document.split('`').skip(1).step_by(2);
    let names = quoted.filter(|name| name.contains('_') && !name.contains(['/', '.', ' ', ':', '\n']));
    let exists = |name: &str| match name.strip_suffix('…') {
        Some(beginning) => tests.iter().any(|test| test.starts_with(beginning)),
        None => tests.contains(name),
    };
    names.filter(|name| !exists(name)).map(str::to_owned).collect()
}

#[cfg(test)]
#[path = "../../tests/unit/check/cited_tests.rs"]
mod tests;
