//! Measures ROS 2 messages through two proxies while busy loops compete for the processors.
//! Compares them with a TCP connection over kernel routers, in turn (`paths.rs` has both).
//!
//! A figure is the median of the rounds. No cable loses a frame, so each repair is needless.

use std::time::Duration;

use anyhow::Result;
use gdp_tests::peers;
use serde::Serialize;

use super::paths::{Bench, BenchRoute, Cables, Hog, LOAD, Load, Measured};
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Duration of each load per path and round, in seconds
    #[arg(long, default_value_t = 6)]
    seconds: u32,
    /// Number of alternating measurements per path
    #[arg(long, default_value_t = 5)]
    rounds: u32,
    /// Number of busy loops; repeat for several. Default: 1, 2 and 4
    #[arg(long = "hogs")]
    hogs: Vec<u32>,
    /// Message size to measure, in bytes; repeat for several. Default: all sizes
    #[arg(long = "bytes")]
    bytes: Vec<usize>,
}

const ROUTES: [BenchRoute; 2] = [BenchRoute::Gdp, BenchRoute::Tcp];

const LOADS: [Load; 3] = [
    Load { bytes: 1_000_000, rate: 30.0, ..LOAD },
    Load { bytes: 6_000_000, rate: 5.0, ..LOAD },
    Load { bytes: 64, rate: 100.0, ..LOAD },
];

/// A load beside a number of busy loops. Arrays have the rounds' figures.
#[derive(Serialize)]
struct HogRow {
    route: BenchRoute,
    bytes: usize,
    rate: f64,
    hogs: u32,
    sent: u64,
    received: Vec<u64>,
    p50_ms: Vec<f64>,
    p99_ms: Vec<f64>,
    /// Frames that the sending proxy sent again.
    repeated: Vec<u64>,
}

pub fn run(options: Options) -> Result<()> {
    let hogs = if options.hogs.is_empty() { vec![1, 2, 4] } else { options.hogs };
    let bench = Bench::prepare(&ROUTES, Profile::Dist)?;
    let mut rows = Vec::new();
    for load in LOADS.iter().filter(|load| options.bytes.is_empty() || options.bytes.contains(&load.bytes)) {
        let count = load.count(options.seconds);
        for &hogs in &hogs {
            let mut samples = ROUTES.map(|_| Vec::new());
            for round in 0..options.rounds {
                for (route, all) in ROUTES.iter().zip(&mut samples) {
                    eprintln!("round {round}: {count} messages of {} B, {hogs} busy loops", load.bytes);
                    let _hogs = Hog::several(hogs)?;
                    all.push(bench.measure(*route, &Cables::default(), load, count)?);
                }
            }
            rows.extend(ROUTES.iter().zip(&samples).map(|(route, all)| row(*route, load, hogs, count, all)));
        }
    }
    if options.json {
        println!("{}", serde_json::json!({ "bench": "hogs", "switches": 3, "rows": rows }));
    } else {
        print_table(&rows);
    }
    Ok(())
}

fn row(route: BenchRoute, load: &Load, hogs: u32, sent: u64, all: &[Measured]) -> HogRow {
    let at = |measured: &Measured, percent| {
        let mut sorted: Vec<Duration> = measured.received.iter().map(|message| message.latency).collect();
        sorted.sort();
        peers::percentile(&sorted, percent).as_secs_f64() * 1000.0
    };
    HogRow {
        route,
        bytes: load.bytes,
        rate: load.rate,
        hogs,
        sent,
        received: all.iter().map(|measured| measured.received.len() as u64).collect(),
        p50_ms: all.iter().map(|measured| at(measured, 50.0)).collect(),
        p99_ms: all.iter().map(|measured| at(measured, 99.0)).collect(),
        repeated: all.iter().filter_map(|measured| measured.repeated).collect(),
    }
}

fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or_default()
}

fn print_table(rows: &[HogRow]) {
    println!("ROS 2 messages beside busy loops; medians of the rounds");
    println!(
        "{:<6} {:>8} {:>5} {:>5} {:>10} {:>6} {:>9} {:>9} {:>8}",
        "path", "bytes", "Hz", "loops", "received", "sent", "p50 ms", "p99 ms", "repairs"
    );
    for row in rows {
        let path = if row.route == BenchRoute::Gdp { "gdp" } else { "tcp" };
        println!(
            "{path:<6} {:>8} {:>5} {:>5} {:>10} {:>6} {:>9.2} {:>9.2} {:>8}",
            row.bytes,
            row.rate,
            row.hogs,
            median(row.received.iter().map(|count| *count as f64)),
            row.sent,
            median(row.p50_ms.iter().copied()),
            median(row.p99_ms.iter().copied()),
            row.repeated.iter().sum::<u64>()
        );
    }
}
