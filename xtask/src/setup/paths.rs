//! Returns the folders of toolchains.

use std::path::{Path, PathBuf};

use gdp_tests::programs::Program;

pub fn home(variable: &str, default: &str) -> PathBuf {
    std::env::var_os(variable)
        .map(PathBuf::from)
        .unwrap_or_else(|| Path::new(&std::env::var_os("HOME").unwrap_or_default()).join(default))
}

/// Returns the path of a program, on `PATH` or in the folder of `cargo install`.
pub fn installed_by_cargo(program: Program) -> Option<PathBuf> {
    let in_home = || home("CARGO_HOME", ".cargo").join("bin").join(program.name());
    program.find().or_else(|| Some(in_home()).filter(|file| file.is_file()))
}
