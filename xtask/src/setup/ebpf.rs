//! Finds the toolchain of the XDP programs: a compiler with `core` for the target, and
//! `bpf-linker`.

use std::path::{Path, PathBuf};

use gdp_tests::programs::{Program, own};

use crate::setup::paths::{home, installed_by_cargo};
use crate::shell;

/// A compiler for the eBPF target. Compiler and `bpf-linker` must have the same major version of
/// LLVM, so setup installs them as a pair.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EbpfCompiler {
    /// Debian's `rustc-web` with the prebuilt `core` of `libstd-rust-web-dev-bpf` (LLVM 22).
    Debian,
    /// A rustup nightly with `rust-src`, which builds `core` itself.
    Nightly,
}

impl EbpfCompiler {
    pub fn find() -> Option<Self> {
        let debian = Path::new("/usr/lib/rustlib/bpfel-unknown-none/lib");
        if Path::new("/usr/bin/rustc").is_file() && debian.is_dir() {
            return Some(Self::Debian);
        }
        let toolchains = std::fs::read_dir(home("RUSTUP_HOME", ".rustup").join("toolchains")).ok()?;
        toolchains
            .flatten()
            .filter(|entry| entry.file_name().to_string_lossy().starts_with("nightly-"))
            .any(|entry| entry.path().join("lib/rustlib/src/rust/library/core").is_dir())
            .then_some(Self::Nightly)
    }
}

/// Returns the path of `bpf-linker`, on `PATH` or in the folder of `cargo install`.
pub fn bpf_linker() -> Option<PathBuf> {
    installed_by_cargo(Program::BpfLinker)
}

pub fn bpf_linker_present() -> bool {
    bpf_linker().is_some_and(|file| {
        shell::output(own(file).arg("--version")).is_some_and(|version| version.starts_with("bpf-linker 0.13."))
    })
}
