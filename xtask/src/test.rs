//! `cargo xtask test`: unit tests, then the tests that need root: real XDP, DPDK, namespaces, DDS.

use std::process::Command;

use anyhow::{Result, bail};

use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};
use crate::{build, peers, shell};

#[derive(clap::Args)]
pub struct Options {
    /// Only tests whose name contains this
    filter: Option<String>,
    /// Only what needs neither root nor an eBPF toolchain nor DPDK
    #[arg(long)]
    unit: bool,
    /// Only compile; with `--unit`
    #[arg(long, requires = "unit")]
    no_run: bool,
    /// Only what needs root
    #[arg(long, conflicts_with = "unit")]
    root: bool,
    /// All but what needs root; also with DPDK
    #[arg(long, conflicts_with_all = ["unit", "root"])]
    no_root: bool,
}

pub fn run(options: Options) -> Result<()> {
    if options.unit {
        setup::ensure(Purpose::Unit)?;
        peers::build()?;
        // The default members, without the DPDK data plane.
        return shell::say_and_run(tests(&options).arg(if options.no_run { "--no-run" } else { "--no-fail-fast" }));
    }
    if !workspace::is_root() {
        // Skipping would look like success, above all in CI.
        bail!("the kernel and namespace tests need root: run as root, or `cargo xtask test --unit` for the rest");
    }
    setup::ensure(Purpose::Test)?;
    peers::build()?;
    // First, so that what is compiled once has the programs inside.
    build::ebpf()?;
    build::ebpf_rebuilt()?;
    if !options.root {
        shell::say_and_run(tests(&options).args(["--workspace", "--no-fail-fast"]))?;
    }
    if options.no_root {
        return Ok(());
    }
    // Of the whole workspace, as above and below: with other packages Cargo would choose other
    // features for the dependencies, and compile them all again.
    let mut executables = shell::cargo();
    executables.args(["build", "--workspace", "--profile", Profile::Checked.name(), "--features", RELAY]);
    shell::say_and_run(executables.args(["--bin", "gdp-ctl", "--bin", "gdp-proxy", "--test", NETWORKS]))?;
    let mut networks = tests(&options);
    networks.args(["--workspace", "--test", NETWORKS]);
    // Two cores: one network at a time, so that a deadline says something.
    shell::say_and_run(networks.args(["--", "--test-threads", "1"]))
}

/// The test target that needs root. It runs only when it is named.
const NETWORKS: &str = "networks";

/// Puts a switch into `gdp-proxy`.
const RELAY: &str = "gdp-proxy/relay";

/// With the relay, whose test and code are behind a feature.
fn tests(options: &Options) -> Command {
    let mut command = shell::cargo();
    command.args(["test", "--profile", Profile::Checked.name(), "--features", RELAY]);
    command.args(options.filter.as_deref());
    command
}
