//! The paths in the working copy. The only I/O is reading the environment.

use std::path::{Path, PathBuf};

/// The features of `gdp-proxy` that a default build lacks: a switch, and graphs of rmw_zenoh. Tests
/// have them.
pub const FEATURES: &str = "gdp-proxy/relay,gdp-proxy/zenoh";

/// Returns the folder of the root `Cargo.toml`.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in the workspace")
}

/// Returns Cargo's target folder, which `CARGO_TARGET_DIR` may set.
pub fn target() -> PathBuf {
    match std::env::var_os("CARGO_TARGET_DIR") {
        Some(dir) => root().join(dir),
        None => root().join("target"),
    }
}

/// Returns the eBPF object that the executables embed, for tests and benchmarks that load it
/// themselves.
pub fn ebpf_object() -> PathBuf {
    target().join("bpf/gdp-ebpf")
}

/// Returns the object with the generators and the sink of `bench forward`.
pub fn ebpf_bench_object() -> PathBuf {
    target().join("bpf/bpfel-unknown-none/release/gdp-ebpf-bench")
}

/// Returns the object without the cost of the hop tag, for comparison in `bench forward`.
pub fn ebpf_untagged_object() -> PathBuf {
    target().join("bpf/bpfel-unknown-none/release/gdp-ebpf-untagged")
}

/// A Cargo profile of the executables.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Profile {
    /// For use from a working copy: quick to compile.
    Release,
    /// For releases and benchmarks: with link-time optimisation.
    Dist,
    /// For tests: optimised, with overflow checks and debug assertions in this project's crates.
    /// Unit and integration tests share it, so that Cargo compiles dependencies once.
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

    /// Returns the folder in which Cargo puts the executables of this profile.
    pub fn executables(self) -> PathBuf {
        target().join(self.name())
    }
}

/// Returns the programs that the network-namespace harness starts.
pub fn tools(profile: Profile) -> gdp_tests::Tools {
    gdp_tests::Tools::new(profile.executables(), target())
}

pub fn is_root() -> bool {
    // SAFETY: geteuid has no preconditions.
    unsafe { libc::geteuid() == 0 }
}

#[cfg(test)]
#[path = "../tests/unit/workspace.rs"]
mod tests;
