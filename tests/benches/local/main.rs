//! One-way latency and frames per second between two endpoints on the switch's own host, over three
//! paths. Run by `cargo xtask bench local`. The benchmark needs root; among the endpoints, only
//! those on packet sockets need it.
//!
//! ```text
//!  daemon   writer ── lo ── userspace plane ── lo ── reader                 (UDP)
//!  packet   writer ── e0 ═ l0 ── XDP ── l1 ═ e1 ── reader                   (Ethernet, packet sockets)
//!  pair     writer ── gdp…h ═ gdp…s ── XDP ── gdp…s ═ gdp…h ── reader       (UDP)
//! ```
//!
//! No daemons run: the tables are what a RIB would install, written through the same `Planes`. The
//! sockets are those of the SDK. All paths exist at once and are measured in turn; a ratio is the
//! median of the rounds' ratios.

mod way;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use clap::Parser;
use serde::Serialize;

use way::{Kind, Way};

#[derive(Parser)]
struct Options {
    /// Object file of the XDP switch
    #[arg(long)]
    ebpf_object: PathBuf,
    /// Number of alternating measurements per path
    #[arg(long, default_value_t = 7)]
    rounds: usize,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 300)]
    milliseconds: u64,
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

#[derive(Serialize)]
struct Row {
    kind: Kind,
    /// One-way latency in microseconds of single frames at 2 kHz: medians of the rounds' median and
    /// 99th percentile.
    p50_us: f64,
    p99_us: f64,
    /// Frames per second with 1300 B of payload. The window is small enough that no frame is lost.
    pps: f64,
    #[serde(skip)]
    rounds: Vec<[f64; 3]>,
}

#[derive(Serialize)]
struct Report {
    /// Version of this schema.
    v: u32,
    rows: Vec<Row>,
    ratios: Vec<Ratio>,
}

/// Comparison of the pair with another path.
#[derive(Serialize)]
struct Ratio {
    with: Kind,
    /// Latency of the pair divided by the other's.
    latency: f64,
    /// Frames per second of the pair divided by the other's.
    pps: f64,
}

fn main() -> Result<()> {
    let options = Options::parse();
    gdp_tests::wait::catch_interrupts();
    gdp_tests::netns::sweep()?;
    let duration = Duration::from_millis(options.milliseconds);
    let mut ways: Vec<Way> = [Kind::Daemon, Kind::Packet, Kind::Pair]
        .into_iter()
        .map(|kind| Way::open(kind, &options.ebpf_object))
        .collect::<Result<_>>()?;
    let new = |way: &Way| Row { kind: way.kind(), p50_us: 0.0, p99_us: 0.0, pps: 0.0, rounds: Vec::new() };
    let mut rows: Vec<Row> = ways.iter().map(new).collect();
    for round in 0..=options.rounds {
        for (way, row) in ways.iter_mut().zip(&mut rows) {
            gdp_tests::wait::check_interrupt()?;
            let latencies = way.latencies(duration)?;
            let at = |percent: usize| latencies[(latencies.len() - 1) * percent / 100].as_nanos() as f64 / 1000.0;
            let found = [at(50), at(99), way.rate(duration)?];
            // The first round warms up caches.
            if round > 0 {
                row.rounds.push(found);
            }
        }
    }
    for way in &ways {
        way.check()?;
    }
    for row in &mut rows {
        [row.p50_us, row.p99_us, row.pps] = [0, 1, 2].map(|i| median(row.rounds.iter().map(|round| round[i])));
    }
    let pair = &rows[2];
    let by = |other: &Row, i: usize| median(pair.rounds.iter().zip(&other.rounds).map(|(a, b)| a[i] / b[i]));
    let ratios = rows[..2].iter().map(|row| Ratio { with: row.kind, latency: by(row, 0), pps: by(row, 2) }).collect();
    let report = Report { v: 1, rows, ratios };
    if options.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
        return Ok(());
    }
    println!("{:<8}{:>9}{:>9}{:>9}", "way", "p50 µs", "p99 µs", "kpps");
    for row in &report.rows {
        println!("{:<8}{:>9.1}{:>9.1}{:>9.0}", row.kind.as_str(), row.p50_us, row.p99_us, row.pps / 1000.0);
    }
    for ratio in &report.ratios {
        let with = ratio.with.as_str();
        println!("the pair by {with}: {:.2} × the latency, {:.2} × the frames", ratio.latency, ratio.pps);
    }
    Ok(())
}

/// Returns the median of at least one value.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
