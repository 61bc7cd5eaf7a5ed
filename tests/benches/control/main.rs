//! Control-plane performance: statements and queries per second at a RIB, memory per name, FIB
//! recovery after a restart, and traffic recovery after a link cut. Run by `cargo xtask bench
//! control`; the rows in namespaces need root.
//!
//! Each file is one row of the figures. A row is a function from [`Bench`] to
//! [`Figure`](gdp_tests::measure::figure::Figure)s:
//!
//! - [`statements`]: advertisements per second at a RIB, compared with the ECDSA verifications
//!   alone
//! - [`queries`]: queries per second to a daemon over its links, compared with requests that ask
//!   nothing
//! - [`memory`]: bytes of a RIB per name
//! - [`scale`]: messages between the RIBs of a thousand domains, in simulated time
//! - [`ring`]: a link of a ring of five is cut, with few names and with many; a daemon is killed
//!   and restarted
//!
//! [`owner`] makes names and entities' statements about them by the thousand.

mod memory;
mod owner;
#[path = "../../tests/networks/patient.rs"]
mod patient;
mod queries;
mod ring;
#[path = "../rows/mod.rs"]
mod rows;
mod scale;
mod statements;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../../tests/networks/traffic/mod.rs"]
mod traffic;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use clap::Parser;
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
    /// Object file of the XDP switch, which the daemons find next to their executable
    #[arg(long = "ebpf-object")]
    _ebpf_object: PathBuf,
    /// Number of alternating measurements per alternative
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 500)]
    milliseconds: u64,
    /// Number of names in the large tables
    #[arg(long, default_value_t = 1_000_000)]
    names: usize,
}

impl Bench {
    fn duration(&self) -> Duration {
        Duration::from_millis(self.milliseconds)
    }
}

const ROWS: [(&str, Row<Bench>); 5] = [
    ("statements", statements::run),
    ("queries", queries::run),
    ("memory", memory::run),
    ("ring", ring::run),
    ("scale", scale::run),
];

fn main() -> Result<()> {
    let Options { bench, rows } = Options::parse();
    gdp_tests::wait::catch_interrupts();
    gdp_tests::netns::sweep()?;
    measure::run(&bench, &ROWS, &rows.wanted())
}
