//! `cargo xtask test`: runs unit tests, then the tests that need root: real XDP, DPDK, namespaces,
//! DDS.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Result, bail};
use gdp_tests::programs::Program;

use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};
use crate::{build, peers, portable, shell};

#[derive(clap::Args, Default)]
pub struct Options {
    /// Run only tests whose name contains this text
    filter: Option<String>,
    /// Run only tests that need neither root, an eBPF toolchain nor DPDK
    #[arg(long)]
    unit: bool,
    /// Compile the tests without running them (only with --unit)
    #[arg(long, requires = "unit")]
    no_run: bool,
    /// Run only tests that need root
    #[arg(long, conflicts_with = "unit")]
    root: bool,
    /// Folder with the executables of another version, for the test of a rolling upgrade
    #[arg(long, requires = "root", value_name = "DIR")]
    previous: Option<PathBuf>,
    /// Run all tests that need no root, including those with DPDK
    #[arg(long, conflicts_with_all = ["unit", "root"])]
    no_root: bool,
    /// Run the unit tests of wire format, certificates, sealing and RIB as on arm64, with qemu
    #[arg(long, conflicts_with_all = ["unit", "root", "no_root"])]
    arm64: bool,
    /// Check that the SDK compiles for Windows and macOS, and run nothing
    #[arg(long, conflicts_with_all = ["filter", "unit", "root", "no_root", "arm64"])]
    portable: bool,
}

/// Runs the test of a rolling upgrade, from the executables in this folder to those of this source.
pub fn rolling_upgrade(previous: PathBuf) -> Result<()> {
    run(Options { filter: Some("rolling::".into()), root: true, previous: Some(previous), ..Options::default() })
}

pub fn run(options: Options) -> Result<()> {
    if options.unit {
        setup::ensure(Purpose::Unit)?;
        peers::build()?;
        // Only the default members, without the DPDK data plane.
        return shell::say_and_run(tests(&options).arg(if options.no_run { "--no-run" } else { "--no-fail-fast" }));
    }
    if options.arm64 {
        setup::ensure(Purpose::Arm64)?;
        return shell::say_and_run(&mut arm64(&options));
    }
    if options.portable {
        setup::ensure(Purpose::Portable)?;
        return shell::say_and_run(&mut portable::command()?);
    }
    if !workspace::is_root() {
        // Skipped tests would look like success, above all in CI.
        bail!("the kernel and namespace tests need root: run as root, or `cargo xtask test --unit` for the rest");
    }
    setup::ensure(Purpose::Test)?;
    peers::build()?;
    // This comes first, so that the executables embed the programs the first time they are
    // compiled.
    build::ebpf()?;
    build::ebpf_rebuilt()?;
    if !options.root {
        let mut command = tests(&options);
        command.args(["--workspace", "--no-fail-fast", "--", "--test-threads", WAITING]);
        shell::say_and_run(&mut command)?;
    }
    if options.no_root {
        return Ok(());
    }
    // Builds the whole workspace, as the other commands do. With another selection of packages
    // Cargo would choose other features for the dependencies, and recompile them all.
    let mut executables = shell::cargo();
    executables.args(["build", "--workspace", "--profile", Profile::Checked.name(), "--features", workspace::FEATURES]);
    shell::say_and_run(executables.args(["--lib", "--bin", "gdp-ctl", "--bin", "gdp-proxy", "--test", NETWORKS]))?;
    let networks = |threads: &str, choice: &[&str]| {
        let mut command = tests(&options);
        command.args(["--workspace", "--test", NETWORKS, "--", "--test-threads", threads]).args(choice);
        command.envs(options.previous.iter().map(|folder| ("GDP_PREVIOUS_PACKAGE", folder)));
        shell::say_and_run(&mut command)
    };
    if options.filter.is_some() {
        return networks("1", &[]);
    }
    let skip: Vec<_> = WHOLE_MACHINE.iter().flat_map(|module| ["--skip", module]).collect();
    // Both run, so that one failure does not hide others.
    let (together, alone) = (networks(WAITING, &skip), networks("1", &WHOLE_MACHINE));
    together.and(alone)
}

/// Number of tests at a time that mostly wait.
const WAITING: &str = "3";

/// Modules of tests that load both cores or measure a path. They run one at a time, so that a
/// missed deadline is meaningful. The other tests mostly wait, and load a fifth of a core each.
const WHOLE_MACHINE: [&str; 14] = [
    "dpdk::",
    "ecn::",
    "end_to_end::",
    "fleet::",
    "generated::",
    "liveness::",
    "local_dds::",
    "losses::",
    "reach_links::",
    "replicas::",
    "selfheal",
    "silence::",
    "soak::",
    "wire::",
];

/// The test target that needs root. It runs only when named.
const NETWORKS: &str = "networks";

/// Returns the command that runs tests, with all features.
fn tests(options: &Options) -> Command {
    let mut command = shell::cargo();
    command.args(["test", "--profile", Profile::Checked.name(), "--features", workspace::FEATURES]);
    command.args(options.filter.as_deref());
    command
}

/// Tests that take minutes under emulation, and whose subject depends on no processor.
const LONG_SIMULATIONS: [&str; 6] =
    ["transport::", "property_tests::", "whatever_", "on_random_graphs", "however_often", "less_and_less_often"];

/// Returns the command that runs the tests of crates without I/O for arm64.
fn arm64(options: &Options) -> Command {
    let mut command = shell::cargo();
    command.args(["test", "--profile", Profile::Checked.name(), "--target", "aarch64-unknown-linux-gnu", "--lib"]);
    command.args(["-p", "gdp-wire", "-p", "gdp-core", "-p", "gdp-e2e", "-p", "gdp-rib"]);
    command.args(options.filter.as_deref());
    command.arg("--").args(LONG_SIMULATIONS.iter().flat_map(|name| ["--skip", name]));
    let runner = format!("{} -L /usr/aarch64-linux-gnu", Program::QemuArm64.name());
    command.env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER", runner);
    command.env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER", Program::CcArm64.name());
    command.env("CC_aarch64_unknown_linux_gnu", Program::CcArm64.name());
    command
}
