//! `cargo xtask build`: the eBPF object, then the executables, the object beside them.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::setup::{self, EbpfCompiler, Part};
use crate::shell;
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Build only the eBPF object
    #[arg(long)]
    ebpf_only: bool,
    /// Build with overflow checks and debug assertions, as the tests do
    #[arg(long)]
    checked: bool,
    /// Build gdp-ctl with the DPDK data plane
    #[arg(long)]
    dpdk: bool,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(&[Part::Workspace, Part::Ebpf])?;
    if options.ebpf_only {
        return ebpf();
    }
    if options.dpdk {
        setup::ensure(&[Part::Dpdk])?;
    }
    all(if options.checked { Profile::Checked } else { Profile::Release }, options.dpdk)
}

/// Everything `gdp-ctl` and `gdp-proxy` need to run with the kernel data plane, and perhaps with DPDK.
pub fn all(profile: Profile, dpdk: bool) -> Result<()> {
    ebpf()?;
    executables(profile, dpdk)?;
    beside_executables(profile)
}

/// The executables alone: enough for the userspace data plane.
pub fn executables(profile: Profile, dpdk: bool) -> Result<()> {
    // All default members, as `test` does: another choice of packages would mean other features of the dependencies.
    let features: &[&str] = if dpdk { &["--features", "gdp-ctl/dpdk"] } else { &[] };
    shell::run(shell::cargo().args(["build", "--profile", profile.name()]).args(features))
}

/// Compiles `gdp-ebpf` with the compiler that [`EbpfCompiler`] finds, to [`workspace::ebpf_object`].
pub fn ebpf() -> Result<()> {
    shell::run(&mut ebpf_cargo("build", "bpf")?)?;
    let built = workspace::target().join("bpf/bpfel-unknown-none/release/gdp-ebpf");
    copy_if_changed(&built, &workspace::ebpf_object())
}

/// The same programs in other instructions, as a later build has them: what a daemon that takes over may come with. Beside the
/// executables, as `gdp-ebpf-rebuilt`.
pub fn ebpf_rebuilt(profile: Profile) -> Result<()> {
    let mut command = ebpf_cargo("build", "bpf-rebuilt")?;
    shell::run(command.args(["--bin", "gdp-ebpf", "--config", "profile.release.opt-level=2"]))?;
    let built = workspace::target().join("bpf-rebuilt/bpfel-unknown-none/release/gdp-ebpf");
    copy_if_changed(&built, &profile.executables().join("gdp-ebpf-rebuilt"))
}

/// The shipped programs with a hop tag that costs nothing, for `bench forward`, to [`workspace::ebpf_untagged_object`].
pub fn ebpf_untagged() -> Result<()> {
    shell::run(ebpf_cargo("build", "bpf")?.args(["--package", "gdp-ebpf-untagged"]))
}

/// `cargo VERB --release` for the eBPF target, in the eBPF workspace, into a folder of Cargo's target folder.
fn ebpf_cargo(verb: &str, into: &str) -> Result<Command> {
    let Some(compiler) = EbpfCompiler::find() else { bail!("no compiler for eBPF: run `cargo xtask setup`") };
    let Some(linker) = setup::bpf_linker() else { bail!("no bpf-linker: run `cargo xtask setup`") };
    let mut command = Command::new("cargo");
    if compiler == EbpfCompiler::Nightly {
        command.arg("+nightly");
    }
    command
        .args([verb, "--release", "--target", "bpfel-unknown-none", "--target-dir"])
        .arg(workspace::target().join(into))
        .current_dir(workspace::root().join("gdp-ebpf"))
        .env("RUSTFLAGS", format!("-C target-cpu=v3 -C debuginfo=2 -C link-arg=--btf -C linker={}", linker.display()))
        .env_remove("RUSTUP_TOOLCHAIN")
        .env_remove("CARGO_ENCODED_RUSTFLAGS");
    match compiler {
        EbpfCompiler::Debian => {
            // Debian's stable compiler; the crates use a few features that only nightly has otherwise.
            command.env("RUSTC", "/usr/bin/rustc").env("RUSTC_BOOTSTRAP", "1");
        }
        EbpfCompiler::Nightly => {
            command.args(["-Z", "build-std=core"]).env_remove("RUSTC");
        }
    }
    Ok(command)
}

fn beside_executables(profile: Profile) -> Result<()> {
    copy_if_changed(&workspace::ebpf_object(), &profile.executables().join("gdp-ebpf"))
}

/// Replaces `to` at once, so that a daemon that starts meanwhile never reads half a file.
fn copy_if_changed(from: &Path, to: &Path) -> Result<()> {
    let new = std::fs::read(from).with_context(|| format!("cannot read {}", from.display()))?;
    if std::fs::read(to).is_ok_and(|old| old == new) {
        return Ok(());
    }
    let folder = to.parent().context("the target has a folder")?;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let temporary = to.with_extension("new");
    std::fs::write(&temporary, new).with_context(|| format!("cannot write {}", temporary.display()))?;
    std::fs::rename(&temporary, to).with_context(|| format!("cannot replace {}", to.display()))
}
