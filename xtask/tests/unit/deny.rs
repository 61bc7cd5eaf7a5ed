//! Unit tests of `deny`, by the rules of the tree.

use std::fs;

use gdp_tests::programs::{Executable as _, Program};

use super::*;

/// What a case adds to a workspace that the rules accept.
#[derive(Default)]
struct Case {
    license: Option<&'static str>,
    name: Option<&'static str>,
    is_from_git: bool,
}

/// Returns whether a workspace with one dependency is accepted, and what cargo-deny printed.
fn check(case: Case) -> (bool, String) {
    let folder = tempfile::tempdir().unwrap();
    let name = case.name.unwrap_or("dependency");
    let dependency = folder.path().join("dependency");
    let package = |name: &str, license: &str| {
        format!(
            "[package]\nname = \"{name}\"\nversion = \"0.1.0\"\nedition = \"2024\"\nlicense = \"{license}\"\npublish = false\n"
        )
    };
    lay_out(&dependency, &package(name, case.license.unwrap_or("MIT")));
    let source = if case.is_from_git {
        commit(&dependency);
        format!("git = \"file://{}\"", dependency.display())
    } else {
        format!("path = {dependency:?}")
    };
    let top = folder.path().join("top");
    lay_out(&top, &format!("{}[dependencies]\n{name} = {{ {source} }}\n", package("top", "MIT")));
    let home = folder.path().join("cargo");
    let mut lock = shell::cargo();
    lock.args(["generate-lockfile", "--quiet", "--manifest-path"]).arg(top.join("Cargo.toml"));
    shell::run(lock.env("CARGO_HOME", &home)).unwrap();
    let output = command(&top, &workspace::root().join(RULES)).env("CARGO_HOME", &home).output().unwrap();
    (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn lay_out(folder: &Path, manifest: &str) {
    fs::create_dir_all(folder.join("src")).unwrap();
    fs::write(folder.join("Cargo.toml"), manifest).unwrap();
    fs::write(folder.join("src/lib.rs"), "").unwrap();
}

fn commit(folder: &Path) {
    let author = ["-c", "user.name=test", "-c", "user.email=test@example.invalid"];
    for words in [&["init", "-q"][..], &["add", "."], &["commit", "-qm", "A dependency"]] {
        shell::run(Program::Git.command().args(author).args(words).current_dir(folder)).unwrap();
    }
}

#[test]
fn a_dependency_with_a_listed_licence_is_accepted() {
    let (is_accepted, printed) = check(Case::default());
    assert!(is_accepted, "{printed}");
}

#[test]
fn a_licence_that_is_not_listed_is_refused() {
    let (is_accepted, printed) = check(Case { license: Some("GPL-3.0-only"), ..Case::default() });
    assert!(!is_accepted && printed.contains("GPL-3.0-only"), "{printed}");
}

#[test]
fn a_source_other_than_the_registry_is_refused() {
    let (is_accepted, printed) = check(Case { is_from_git: true, ..Case::default() });
    assert!(!is_accepted && printed.contains("source-not-allowed"), "{printed}");
}

#[test]
fn a_banned_crate_is_refused() {
    let (is_accepted, printed) = check(Case { name: Some("openssl-sys"), ..Case::default() });
    assert!(!is_accepted && printed.contains("explicitly banned"), "{printed}");
}
