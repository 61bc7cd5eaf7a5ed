//! `cargo xtask test`: unit tests, then the tests that need root: real XDP, DPDK, namespaces, DDS.

use anyhow::{Result, bail};

use crate::setup::{self, Part};
use crate::workspace::{self, Profile};
use crate::{build, peers, shell};

#[derive(clap::Args)]
pub struct Options {
    /// Only tests whose name contains this
    filter: Option<String>,
    /// Only what needs neither root nor an eBPF toolchain nor DPDK
    #[arg(long)]
    unit: bool,
    /// Only what needs root
    #[arg(long, conflicts_with = "unit")]
    root: bool,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(&[Part::Workspace, Part::Etcd, Part::Rosbags, Part::Ros1, Part::Ros2, Part::Dds])?;
    peers::build()?;
    if !options.root {
        shell::say_and_run(tests(&options).args(["--no-fail-fast"]))?;
    }
    if options.unit {
        return Ok(());
    }
    if !workspace::is_root() {
        // Skipping would look like success, above all in CI.
        bail!("the kernel and namespace tests need root: run as root, or `cargo xtask test --unit` for the rest");
    }
    setup::ensure(&[Part::Ebpf, Part::Namespaces, Part::Dpdk])?;
    // What is above does without DPDK, so that this is tried as well.
    shell::say_and_run(tests(&options).args(["-p", "gdp-dpdk"]))?;
    build::all(Profile::Checked, true)?;
    build::ebpf_rebuilt(Profile::Checked)?;
    let mut command = tests(&options);
    // Of the whole workspace, and not with `-p gdp-tests`: Cargo would choose other features for the dependencies, and compile
    // them all again.
    command.args(["--workspace", "--test", "networks"]);
    // Two cores: one network at a time, so that a deadline says something.
    shell::say_and_run(command.args(["--", "--test-threads", "1"]))
}

fn tests(options: &Options) -> std::process::Command {
    let mut command = shell::cargo();
    command.args(["test", "--profile", Profile::Checked.name()]);
    command.args(options.filter.as_deref());
    command
}
