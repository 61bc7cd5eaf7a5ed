//! The package, as pip installs it in an environment of its own.

use std::path::{Path, PathBuf};
use std::process::Command;

use gdp_tests::programs::{Executable as _, Program, own};
use serde_json::json;

/// Python with the package, pytest and mypy.
pub struct Installed {
    python: PathBuf,
    /// Where pytest and mypy are.
    tools: String,
}

impl Installed {
    /// Has pip make a wheel of the library that the tests built, and install it in `folder`.
    pub fn new(folder: &Path) -> Self {
        let sdk = environment("venv-sdk");
        let tools = output(own(&sdk).args(["-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]));
        let new = folder.join("venv");
        output(own(&sdk).args(["-m", "venv", "--without-pip"]).arg(&new));
        let installed = Self { python: new.join("bin/python"), tools };

        let mut pip = own(&sdk);
        pip.args(["-m", "pip", "--python"]).arg(&installed.python);
        // The backend is that of setup, so that nothing is loaded from PyPI.
        pip.args(["install", "--no-index", "--no-deps", "--no-build-isolation", "--no-cache-dir"]);
        let target = folder.join("target").display().to_string();
        let maturin = ["--profile checked", "--compression-method stored", "--target-dir", &target].join(" ");
        pip.arg(format!("--config-settings=build-args={maturin}"));
        pip.arg(env!("CARGO_MANIFEST_DIR")).env("PYTHONPATH", &installed.tools);
        let paths = std::env::var_os("PATH").unwrap_or_default();
        let paths = std::iter::once(sdk.with_file_name("")).chain(std::env::split_paths(&paths));
        pip.env("PATH", std::env::join_paths(paths).unwrap());
        pip.env("CARGO", concat!(env!("CARGO_MANIFEST_DIR"), "/tests/built.sh"));
        output(pip.env("GDP_TEST_ARTIFACT", artifact(folder)));
        installed
    }

    pub fn python(&self) -> Command {
        let mut python = own(&self.python);
        python.env("PYTHONPATH", &self.tools).env("PYTHONDONTWRITEBYTECODE", "1");
        python
    }
}

/// Writes what cargo prints about the library. Maturin moves the library, so it gets a copy.
fn artifact(folder: &Path) -> PathBuf {
    let built = existing(profile().join("deps/libgdp_python.so"), "cargo test -p gdp-python");
    let (library, messages) = (folder.join("libgdp_python.so"), folder.join("artifact.json"));
    std::fs::copy(built, &library).unwrap();
    let package = output(Program::Cargo.command().args(["pkgid", "--offline"]).current_dir(env!("CARGO_MANIFEST_DIR")));
    let artifact = json!({
        "reason": "compiler-artifact",
        "package_id": package,
        "manifest_path": concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"),
        "target": {
            "kind": ["cdylib"],
            "crate_types": ["cdylib"],
            "name": "gdp_python",
            "src_path": concat!(env!("CARGO_MANIFEST_DIR"), "/src/lib.rs"),
        },
        "profile": {
            "opt_level": "0",
            "debuginfo": 1,
            "debug_assertions": true,
            "overflow_checks": true,
            "test": false,
        },
        "features": [],
        "filenames": [library],
        "executable": null,
        "fresh": true,
    });
    std::fs::write(&messages, format!("{artifact}\n{}\n", json!({"reason": "build-finished", "success": true})))
        .unwrap();
    messages
}

/// Returns the trimmed output of a command that succeeds.
fn output(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{command:?}: {text}{}", String::from_utf8_lossy(&output.stderr));
    text.trim().to_owned()
}

/// Returns the Python of an environment of setup.
pub fn environment(name: &str) -> PathBuf {
    existing(profile().with_file_name(name).join("bin/python"), "cargo xtask setup test")
}

/// Cargo's folder of this profile: this test is in `target/PROFILE/deps`.
pub fn profile() -> PathBuf {
    std::env::current_exe().unwrap().ancestors().nth(2).unwrap().into()
}

pub fn existing(file: PathBuf, remedy: &str) -> PathBuf {
    assert!(file.is_file(), "{} does not exist: run `{remedy}`", file.display());
    file
}
