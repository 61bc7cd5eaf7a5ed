//! The cost of forwarding, compared with other forwarders in the same run. Run by `cargo xtask
//! bench forward`; needs root.
//!
//! Each file is one row of the figures. A row is a function from [`Bench`] to [`Figure`]s:
//!
//! - [`cost`]: nanoseconds of one frame in the switch, by test runs
//! - [`dpdk`]: the same in a DPDK loop, compared with [`testpmd`]; [`dpdk_idle`]: the cost of an
//!   idle loop
//! - [`fib`]: lookups in a FIB of a million names (programs and tables: [`lookups`]), and changes
//!   to it
//! - [`hops`]: frames per second through chains of switches
//! - [`crossings`]: frames per second between links of several kinds
//! - [`replication`]: the cost of a copy
//! - [`updates`]: frames per second while routes change
//! - [`flood`]: frames to known names while others send to unknown ones
//! - [`senders`]: the cost of the first switch for a program that sends on a socket (other senders:
//!   [`rings`])
//!
//! The rows use [`path`] and [`star`] (forwarders; based on [`switch`]), [`traffic`] (generators
//! and sink), and [`gdp_tests::measure`] (rounds, CPUs, results). [`series`] names the contenders.
//!
//! No daemons run: the tables are what a RIB would install, written through the same `Planes`.

mod cost;
mod crossings;
mod dpdk;
mod dpdk_idle;
mod fib;
mod flood;
mod hops;
mod lookups;
mod path;
mod replication;
mod rings;
#[path = "../rows/mod.rs"]
mod rows;
mod senders;
mod series;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../../tests/networks/star/mod.rs"]
mod star;
mod switch;
mod testpmd;
mod traffic;
mod updates;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, bail};
use clap::Parser;
use gdp_dataplane::kernel::KernelPlane;
use gdp_tests::measure::{self, Row};

use rows::Rows;

#[derive(Parser)]
struct Options {
    #[command(flatten)]
    bench: Bench,
    #[command(flatten)]
    rows: Rows,
}

/// Parameters of every row.
#[derive(clap::Args)]
struct Bench {
    /// Object file of the XDP switch
    #[arg(long)]
    ebpf_object: PathBuf,
    /// Object file of the XDP switch with a hop tag without cost
    #[arg(long)]
    untagged_object: PathBuf,
    /// Object file of the generators and the sink
    #[arg(long)]
    bench_object: PathBuf,
    /// Number of alternating measurements per alternative
    #[arg(long, default_value_t = 7)]
    rounds: usize,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 200)]
    milliseconds: u64,
}

impl Bench {
    fn duration(&self) -> Duration {
        Duration::from_millis(self.milliseconds)
    }
}

const ROWS: [(&str, Row<Bench>); 12] = [
    ("cost", cost::run),
    ("dpdk", dpdk::run),
    ("dpdk-hop", hops::dpdk),
    ("dpdk-idle", dpdk_idle::run),
    ("fib", fib::run),
    ("hops", hops::small_frames),
    ("large", hops::large_frames),
    ("crossings", crossings::run),
    ("replication", replication::run),
    ("live-updates", updates::run),
    ("flood", flood::run),
    ("senders", senders::run),
];

/// Attaches the loss counter for all namespaces. A host has one switch, which examines every batch
/// of redirected frames for losses. Here hosts are namespaces of one machine: one plane counts for
/// all, also for the forwarders under comparison.
fn count_losses(bench: &Bench) -> Result<KernelPlane> {
    const LOOPBACK: u32 = 1;
    let mut plane = KernelPlane::load(&bench.ebpf_object, 1)?;
    plane.set_port(LOOPBACK, LOOPBACK)?;
    match plane.uncounted() {
        None => Ok(plane),
        Some(error) => bail!("losses are not counted: {error}"),
    }
}

fn main() -> Result<()> {
    let Options { bench, rows } = Options::parse();
    gdp_tests::wait::catch_interrupts();
    gdp_tests::netns::sweep()?;
    let _host = count_losses(&bench)?;
    measure::run(&bench, &ROWS, &rows.wanted())
}
