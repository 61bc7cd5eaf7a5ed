//! Checks the patches of `third_party/rustdds`: their form, and that git applies them to the
//! published crate.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};
use gdp_tests::programs::{Executable as _, Program, own};
use serde_json::Value;

/// What the name of a patch begins with: its number in the series.
const NUMBER_LEN: usize = 4;

#[test]
fn each_patch_states_its_reason() -> Result<()> {
    for (index, path) in patches()?.iter().enumerate() {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let text = fs::read_to_string(path)?;
        let (header, diff) = text.split_once("\n---\n").with_context(|| format!("{name}: no end of the header"))?;
        let (mail, reason) = header.split_once("\n\n").with_context(|| format!("{name}: no reason"))?;
        let title = mail.lines().find_map(|line| line.strip_prefix("Subject: [PATCH] "));
        let title = title.with_context(|| format!("{name}: no title"))?;

        ensure!(name.get(..NUMBER_LEN) == Some(&format!("{:04}", index + 1)), "{name}: not number {}", index + 1);
        ensure!(title.len() > 10, "{name}: the title says nothing");
        let symptom = reason.split("\n\n").find(|part| part.starts_with("Symptom without this change: "));
        ensure!(symptom.is_some(), "{name}: the last paragraph states no \"Symptom without this change: …\"");
        ensure!(reason.split("\n\n").count() > 1, "{name}: states a symptom, but no cause");
        for line in diff.lines().filter(|line| line.starts_with("diff --git ")) {
            ensure!(line.starts_with("diff --git a/src/"), "{name}: changes a file outside of src: {line}");
        }
    }
    Ok(())
}

#[test]
fn git_applies_the_series_to_the_published_crate() -> Result<()> {
    let published = published()?;
    let manifest = Path::new(published["manifest_path"].as_str().context("no path")?);
    let repository = tempfile::tempdir()?;
    let source = manifest.parent().context("no folder")?.join("src");
    run(Program::Cp.command().arg("-r").arg(source).arg(repository.path()))?;
    let git = |arguments: &[&str]| {
        let mut git = Program::Git.command();
        git.current_dir(repository.path()).args(["-c", "user.name=test", "-c", "user.email=test@localhost"]);
        git.args(arguments);
        git
    };
    run(&mut git(&["init", "--quiet"]))?;
    run(&mut git(&["add", "--all"]))?;
    run(&mut git(&["commit", "--quiet", "--message", "published"]))?;
    run(git(&["am", "--quiet"]).args(patches()?))?;
    let log = git(&["rev-list", "--count", "HEAD~1"]).output()?;
    assert_eq!(String::from_utf8(log.stdout)?.trim(), patches()?.len().to_string());
    Ok(())
}

/// A newer version may need other dependencies, and the patched crate has a manifest of its own.
#[test]
fn the_manifest_is_the_published_one() -> Result<()> {
    let patched = metadata(&folder().join("Cargo.toml"), &["--no-deps"])?;
    let patched = package(&patched, "rustdds")?;
    let published = published()?;
    assert_eq!(dependencies(&patched)?, dependencies(&published)?);
    for key in ["version", "features", "edition", "license"] {
        assert_eq!(patched[key], published[key], "{key}");
    }
    Ok(())
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../third_party/rustdds")
}

fn patches() -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder().join("patches"))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    ensure!(!paths.is_empty(), "no patches");
    Ok(paths)
}

/// Looks the published crate up as `build.rs` does: by a copy of the manifest, with the versions of
/// the workspace.
fn published() -> Result<Value> {
    let copy = tempfile::tempdir()?;
    fs::copy(folder().join("published/Cargo.toml"), copy.path().join("Cargo.toml"))?;
    fs::copy(folder().join("../../Cargo.lock"), copy.path().join("Cargo.lock"))?;
    package(&metadata(&copy.path().join("Cargo.toml"), &[])?, "rustdds")
}

fn metadata(manifest: &Path, options: &[&str]) -> Result<Value> {
    let mut cargo = own(PathBuf::from(std::env::var_os("CARGO").context("no CARGO")?));
    cargo.args(["metadata", "--format-version", "1", "--filter-platform", "x86_64-unknown-linux-gnu"]);
    let output = cargo.args(options).arg("--manifest-path").arg(manifest).output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}

fn package(metadata: &Value, name: &str) -> Result<Value> {
    let packages = metadata["packages"].as_array().context("no packages")?;
    packages.iter().find(|package| package["name"] == name).cloned().context("no such package")
}

/// Dependencies of the library, as cargo describes them, in the order of their names.
fn dependencies(package: &Value) -> Result<Vec<String>> {
    let all = package["dependencies"].as_array().context("no dependencies")?;
    let mut normal: Vec<String> = all.iter().filter(|one| one["kind"].is_null()).map(Value::to_string).collect();
    normal.sort();
    Ok(normal)
}

fn run(command: &mut Command) -> Result<()> {
    let output = command.output()?;
    ensure!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    Ok(())
}
