//! Measures the cost of forwarding: XDP beside a bare redirect, the kernel's IPv4 routers and a
//! forwarder on packet sockets. It builds and runs a bench target of `gdp-tests`, which has the
//! eBPF loader and does the measurements.

use anyhow::Result;

use crate::{build, shell, workspace};

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    rows: super::program::Rows,
    /// Number of alternating measurements per alternative
    #[arg(long, default_value_t = 7)]
    rounds: u32,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 200)]
    milliseconds: u64,
}

pub fn run(options: Options) -> Result<()> {
    let mut command = super::program::target("forward")?;
    build::ebpf_untagged()?;
    command.arg("--untagged-object").arg(workspace::ebpf_untagged_object());
    command.arg("--bench-object").arg(workspace::ebpf_bench_object());
    options.rows.pass(&mut command);
    super::program::pass(&mut command, options.rounds, options.milliseconds, options.json);
    shell::run(&mut command)
}
