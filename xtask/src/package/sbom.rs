//! The bill of materials of an executable: CycloneDX 1.5, as JSON.
//! <https://cyclonedx.org/docs/1.5/json/>
//!
//! It lists the crates whose code is linked in, by `cargo tree`, with checksums of `Cargo.lock`.
//! Macros, build scripts and the C library are not linked in. Equal sources make an equal bill.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Value, json};

use super::build::Build;
use crate::shell;
use crate::workspace::{self, FEATURES};

/// The crate that embeds the XDP programs, and the crate that they are.
const EMBEDS: &str = "gdp-dataplane";
const EMBEDDED: &str = "gdp-ebpf";

/// Crates with their dependencies. Keys are `NAME@VERSION`.
#[derive(Default)]
struct CrateGraph {
    crates: BTreeMap<String, LinkedCrate>,
    dependencies: BTreeMap<String, BTreeSet<String>>,
}

struct LinkedCrate {
    name: String,
    version: String,
    /// An SPDX expression.
    license: String,
    /// Whether it is of this project, so that no registry has it.
    is_own: bool,
}

/// Writes the bill of an executable into the folder of its package's documents.
pub fn write(executable: &str, build: &Build, documents: &Path) -> Result<()> {
    let file = documents.join(format!("{executable}.cdx.json"));
    let bill = serde_json::to_string_pretty(&bill(executable, build)?)? + "\n";
    fs::write(&file, bill).with_context(|| format!("cannot write {}", file.display()))
}

fn bill(executable: &str, build: &Build) -> Result<Value> {
    let root = workspace::root();
    // Both executables are compiled by one command, which decides the features of what they share.
    let mut graph = tree(root, &["-p", "gdp-ctl", "-p", "gdp-proxy", "--features", FEATURES], build.arch.target())?;
    let programs = root.join("gdp-ebpf");
    graph.embed(tree(&programs, &[], build.arch.target())?)?;
    let mut checksums = BTreeMap::new();
    for lock in [root.join("Cargo.lock"), programs.join("Cargo.lock")] {
        let text = fs::read_to_string(&lock).with_context(|| format!("cannot read {}", lock.display()))?;
        checksums.extend(sha256_of_crates(&text));
    }
    graph.bill(executable, &build.version, &checksums)
}

/// Returns what the crates of a workspace link, on a target.
fn tree(folder: &Path, selection: &[&str], target: &str) -> Result<CrateGraph> {
    let mut command = shell::cargo();
    command.current_dir(folder).args(["tree", "--locked", "--edges", "normal,no-proc-macro", "--target", target]);
    command.args(["--prefix", "depth", "--format", "|{p}|{l}"]).args(selection);
    let listed = shell::output(&mut command).with_context(|| format!("`cargo tree` failed in {}", folder.display()))?;
    CrateGraph::parse(&listed)
}

impl CrateGraph {
    /// Parses lines `DEPTH|NAME vVERSION (PATH)|LICENSE`. Cargo lists the dependencies of a crate
    /// at its first line only.
    fn parse(listed: &str) -> Result<Self> {
        let mut graph = Self::default();
        let mut above: Vec<String> = Vec::new();
        for line in listed.lines().filter(|line| !line.is_empty()) {
            let malformed = || format!("`cargo tree` wrote {line:?}");
            let mut parts = line.splitn(3, '|');
            let (depth, package, license) = (parts.next(), parts.next(), parts.next());
            let (Some(depth), Some(package), Some(license)) = (depth, package, license) else { bail!(malformed()) };
            let depth: usize = depth.parse().with_context(malformed)?;
            let (name, rest) = package.split_once(" v").with_context(malformed)?;
            let (version, path) = rest.split_once(' ').unwrap_or((rest, ""));
            let license = license.trim_end_matches("(*)");
            ensure!(!license.trim().is_empty(), "{name} {version} states no licence as SPDX expression");
            let key = format!("{name}@{version}");
            let is_own = path.starts_with("(/") && !path.contains("/third_party/");
            let entry = LinkedCrate { name: name.into(), version: version.into(), license: spdx(license), is_own };
            ensure!(depth <= above.len(), malformed());
            above.truncate(depth);
            if let Some(parent) = above.last() {
                graph.dependencies.entry(parent.clone()).or_default().insert(key.clone());
            }
            graph.crates.insert(key.clone(), entry);
            above.push(key);
        }
        Ok(graph)
    }

    /// Adds the XDP programs as a dependency of the crate that embeds them.
    fn embed(&mut self, programs: Self) -> Result<()> {
        let key = |graph: &Self, name: &str| {
            let mut entries = graph.crates.iter();
            let found = entries.find(|(_, entry)| entry.name == name).map(|(key, _)| key.clone());
            found.with_context(|| format!("`cargo tree` lists no {name}"))
        };
        let (above, below) = (key(self, EMBEDS)?, key(&programs, EMBEDDED)?);
        self.crates.extend(programs.crates);
        for (from, to) in programs.dependencies {
            self.dependencies.entry(from).or_default().extend(to);
        }
        self.dependencies.entry(above).or_default().insert(below);
        Ok(())
    }

    /// Returns the bill of one crate, which is an executable: of all that it reaches.
    fn bill(&self, executable: &str, version: &str, checksums: &BTreeMap<String, String>) -> Result<Value> {
        let mut top = self.crates.iter().filter(|(_, entry)| entry.name == executable);
        let (top, application) = top.next().with_context(|| format!("`cargo tree` lists no {executable}"))?;
        let of = |key: &String| self.dependencies.get(key).into_iter().flatten();
        let (mut reached, mut queue) = (BTreeSet::from([top]), vec![top]);
        while let Some(key) = queue.pop() {
            queue.extend(of(key).filter(|key| reached.insert(key)));
        }
        let libraries = reached.iter().filter(|key| **key != top);
        let components = libraries.map(|key| self.component(key, checksums.get(*key))).collect::<Result<Vec<_>>>()?;
        let edges = reached.iter().map(|key| json!({"ref": key, "dependsOn": of(key).collect::<Vec<_>>()}));
        Ok(json!({
            "bomFormat": "CycloneDX",
            "specVersion": "1.5",
            "version": 1,
            "metadata": {"component": {
                "type": "application",
                "bom-ref": top,
                "name": application.name,
                "version": version,
                "licenses": [{"expression": application.license}],
            }},
            "components": components,
            "dependencies": edges.collect::<Vec<_>>(),
        }))
    }

    fn component(&self, key: &str, sha256: Option<&String>) -> Result<Value> {
        let LinkedCrate { name, version, license, is_own } = &self.crates[key];
        let mut component = json!({
            "type": "library",
            "bom-ref": key,
            "name": name,
            "version": version,
            "licenses": [{"expression": license}],
        });
        if !is_own {
            component["purl"] = json!(format!("pkg:cargo/{name}@{}", version.replace('+', "%2B")));
        }
        match sha256 {
            Some(sha256) => component["hashes"] = json!([{"alg": "SHA-256", "content": sha256}]),
            // A crate of another origin than the registry: a folder of this tree.
            None if !is_own => component["pedigree"] = json!({"notes": "With patches of this project."}),
            None => {}
        }
        Ok(component)
    }
}

/// Returns a licence as an SPDX expression: older crates separate alternatives by a slash.
fn spdx(license: &str) -> String {
    license.split('/').map(str::trim).collect::<Vec<_>>().join(" OR ")
}

/// Returns the checksums that a `Cargo.lock` states, by `NAME@VERSION`.
fn sha256_of_crates(lock: &str) -> BTreeMap<String, String> {
    let value = |entry: &str, key: &str| {
        let mut lines = entry.lines();
        lines.find_map(|line| Some(line.strip_prefix(key)?.strip_prefix(" = \"")?.trim_end_matches('"').to_owned()))
    };
    let entries = lock.split("[[package]]").skip(1);
    let stated = entries.filter_map(|entry| {
        let key = format!("{}@{}", value(entry, "name")?, value(entry, "version")?);
        Some((key, value(entry, "checksum")?))
    });
    stated.collect()
}

#[cfg(test)]
#[path = "../../tests/unit/package/sbom.rs"]
mod tests;
