//! Measures service calls that go to one, two or three servers at once (`replicate`). All servers
//! are well, or one of them is stalled for a part of each second.
//!
//! ```text
//!  rclpy server ── proxy ──┐
//!  rclpy server ── proxy ──┼── switch ── proxy ── rclpy client
//!  rclpy server ── proxy ──┘
//! ```
//!
//! All paths are loopback. The client's proxy has the same key in each measurement, so its nearest
//! server is the same. That server is the one that stalls: SIGSTOP, and SIGCONT later. Calls have a
//! fixed rate, and their time begins when they are due.

mod site;

use std::time::Duration;

use anyhow::{Result, ensure};
use gdp_tests::{peers, wait};
use serde::Serialize;

use self::site::Site;
use crate::build::{self, Executables, Features};
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Duration of each measurement in seconds
    #[arg(long, default_value_t = 10)]
    seconds: u32,
    /// Calls per second
    #[arg(long, default_value_t = 50)]
    rate: u32,
    /// Number of alternating measurements per row
    #[arg(long, default_value_t = 3)]
    rounds: u32,
    /// Time in each second for which a server is stalled, in milliseconds
    #[arg(long, default_value_t = 200)]
    stall: u64,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    checked: bool,
}

/// The numbers of servers to which a call goes.
const COPIES: [u8; 3] = [1, 2, 3];

#[derive(Serialize)]
struct Row {
    /// The number of servers to which each call goes.
    replicate: u8,
    /// Milliseconds of each second for which the nearest server is stalled; 0 for none.
    stall_ms: u64,
    calls: u64,
    answers: u64,
    p50_ms: f64,
    p99_ms: f64,
    max_ms: f64,
    /// The 99th percentile divided by that of one server, in the same state of the servers.
    p99_over_one: f64,
}

pub fn run(options: Options) -> Result<()> {
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    setup::ensure(Purpose::Bench)?;
    build::executables(Executables::All, profile, Features::default())?;
    wait::catch_interrupts();
    let mut site = Site::start(&workspace::tools(profile))?;
    let nearest = site.nearest()?;
    let stalls = [Duration::ZERO, Duration::from_millis(options.stall)];
    let kinds: Vec<(Duration, u8)> =
        stalls.into_iter().flat_map(|stall| COPIES.map(|copies| (stall, copies))).collect();
    let mut samples: Vec<Vec<Duration>> = kinds.iter().map(|_| Vec::new()).collect();
    let count = options.seconds * options.rate;
    for round in 0..options.rounds {
        for ((stall, copies), taken) in kinds.iter().zip(&mut samples) {
            eprintln!("round {}: replicate {copies}, stalled for {stall:?} of each second", round + 1);
            taken.extend(site.measure(*copies, count, options.rate, (nearest, *stall))?);
        }
    }
    let calls = u64::from(count) * u64::from(options.rounds);
    let rows = rows(&kinds, samples, calls)?;
    if options.json {
        println!("{}", serde_json::json!({ "bench": "calls", "rate": options.rate, "rows": rows }));
    } else {
        print_table(&rows);
    }
    Ok(())
}

fn rows(kinds: &[(Duration, u8)], samples: Vec<Vec<Duration>>, calls: u64) -> Result<Vec<Row>> {
    let (mut rows, mut one) = (Vec::new(), 0.0);
    for ((stall, copies), mut taken) in kinds.iter().zip(samples) {
        ensure!(!taken.is_empty(), "no call was answered with replicate {copies}");
        taken.sort();
        let at = |percent| peers::percentile(&taken, percent).as_secs_f64() * 1000.0;
        if *copies == 1 {
            one = at(99.0);
        }
        rows.push(Row {
            replicate: *copies,
            stall_ms: stall.as_millis() as u64,
            calls,
            answers: taken.len() as u64,
            p50_ms: at(50.0),
            p99_ms: at(99.0),
            max_ms: at(100.0),
            p99_over_one: at(99.0) / one,
        });
    }
    Ok(rows)
}

fn print_table(rows: &[Row]) {
    println!("service calls from rclpy to rclpy, in milliseconds from when each was due");
    println!(
        "{:>9}  {:>12}  {:>11}  {:>7}  {:>7}  {:>7}  {:>16}",
        "replicate", "stalled ms/s", "answered", "p50", "p99", "max", "p99 / p99 of one"
    );
    for row in rows {
        let Row { replicate, stall_ms, calls, answers, p50_ms, p99_ms, max_ms, p99_over_one } = row;
        let answered = format!("{answers}/{calls}");
        println!(
            "{replicate:>9}  {stall_ms:>12}  {answered:>11}  {p50_ms:>7.2}  {p99_ms:>7.2}  {max_ms:>7.1}  {p99_over_one:>16.2}"
        );
    }
}
