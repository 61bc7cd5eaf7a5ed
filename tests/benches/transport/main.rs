//! Messages from one program to another: this SDK, QUIC, and TLS over TCP, in the same namespaces
//! in the same run. Run by `cargo xtask bench transport`; needs root.
//!
//! ```text
//!  robot r0 ── l0 s1 r0 ── [wire] ── l0 cloud        s1: the XDP switch for frames of GDP, a router for IP
//!  CPU 0                             CPU 1
//! ```
//!
//! Each file is one row of the figures. A row is a function from [`Bench`] to
//! [`Figure`](gdp_tests::measure::figure::Figure)s:
//!
//! - [`throughput`]: bytes per second by message size, and CPU time per gigabyte
//! - [`latency`]: messages at fixed rates over bad links
//! - [`signing`]: messages sealed and opened per second, without a network
//! - [`flood`]: messages at a fixed rate while an attacker floods their link
//!
//! The rows use [`site`] (network and switch), [`lane`] (messages and their results), [`run`] (both
//! together, for a while) and [`usage`] (CPU time and memory). The contenders are [`ours`],
//! [`quic`] and [`tls`]; each depends only on [`lane`] and [`site`].

mod flood;
#[path = "../../tests/networks/inside/mod.rs"]
mod inside;
mod lane;
mod latency;
mod ours;
mod quic;
#[path = "../rows/mod.rs"]
mod rows;
mod run;
#[path = "../sealing/mod.rs"]
mod sealing;
mod signing;
mod site;
mod throughput;
mod tls;
mod usage;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use clap::Parser;
use gdp_tests::measure::{self, Row};

use rows::Rows;
use run::Open;

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
    /// Number of alternating measurements per alternative
    #[arg(long, default_value_t = 7)]
    rounds: usize,
    /// Duration of a measurement, in milliseconds; measurements at a fixed rate take six times as
    /// long
    #[arg(long, default_value_t = 500)]
    milliseconds: u64,
}

impl Bench {
    fn duration(&self) -> Duration {
        Duration::from_millis(self.milliseconds)
    }

    /// Returns the length of a measurement at a fixed rate, which has few messages.
    fn long_duration(&self) -> Duration {
        6 * self.duration()
    }
}

const ROWS: [(&str, Row<Bench>); 4] =
    [("throughput", throughput::run), ("latency", latency::run), ("signing", signing::run), ("flood", flood::run)];

/// The transports by their names in the figures; this SDK's come first.
const TRANSPORTS: [(&str, Open); 5] = [
    (ours::BEST_EFFORT, ours::best_effort),
    (ours::RELIABLE, ours::reliable),
    (quic::CUBIC, quic::cubic),
    (tls::CUBIC, tls::cubic),
    (ours::ETHERNET, ours::reliable_on_ethernet),
];

fn main() -> Result<()> {
    let Options { bench, rows } = Options::parse();
    gdp_tests::wait::catch_interrupts();
    gdp_tests::netns::sweep()?;
    measure::run(&bench, &ROWS, &rows.wanted())
}
