//! Where things are in the working copy. No I/O beyond reading the environment.

use std::path::{Path, PathBuf};

/// The folder of the root `Cargo.toml`.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in the workspace")
}

/// Cargo's target folder, `CARGO_TARGET_DIR` respected.
pub fn target() -> PathBuf {
    match std::env::var_os("CARGO_TARGET_DIR") {
        Some(dir) => root().join(dir),
        None => root().join("target"),
    }
}

/// The eBPF object that the executables embed, for tests and benchmarks that load it themselves.
pub fn ebpf_object() -> PathBuf {
    target().join("bpf/gdp-ebpf")
}

/// The object with the generators and the sink of `bench forward`.
pub fn ebpf_bench_object() -> PathBuf {
    target().join("bpf/bpfel-unknown-none/release/gdp-ebpf-bench")
}

/// The object that `bench forward` compares the shipped one with, to show what the hop tag costs.
pub fn ebpf_untagged_object() -> PathBuf {
    target().join("bpf/bpfel-unknown-none/release/gdp-ebpf-untagged")
}

/// Which of Cargo's profiles an executable is built with.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Profile {
    /// What people run from a working copy: quick to compile.
    Release,
    /// What is shipped and measured: with link-time optimisation.
    Dist,
    /// Optimised, with overflow checks and debug assertions in this project's crates: what is
    /// tested. One profile for unit and integration tests, so that dependencies are compiled once.
    Checked,
}

impl Profile {
    pub fn name(self) -> &'static str {
        match self {
            Self::Release => "release",
            Self::Dist => "dist",
            Self::Checked => "checked",
        }
    }

    /// Where Cargo puts the executables of this profile.
    pub fn executables(self) -> PathBuf {
        target().join(self.name())
    }
}

/// The programs the network-namespace harness starts.
pub fn tools(profile: Profile) -> gdp_tests::Tools {
    gdp_tests::Tools::new(profile.executables(), target())
}

pub fn is_root() -> bool {
    // SAFETY: geteuid has no preconditions.
    unsafe { libc::geteuid() == 0 }
}
