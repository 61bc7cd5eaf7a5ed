//! The result of one load on one path, over all rounds.

use std::time::Duration;

use anyhow::Result;
use gdp_tests::peers::{self, Vendor};
use serde::Serialize;

use super::{Bench, BenchRoute, Cell, Hog, Load, Measured};

#[derive(Serialize)]
pub struct PathRow {
    pub route: BenchRoute,
    /// The cables between the hosts.
    pub cables: String,
    /// Busy loops beside the measurement.
    pub hogs: u32,
    bytes: usize,
    /// Messages per second, on all topics together.
    rate: f64,
    topics: u32,
    vendor: &'static str,
    pub sent: u64,
    pub received: u64,
    /// Number of messages that arrived damaged.
    damaged: u64,
    /// Latency from `write` to the callback, in microseconds.
    pub latency_us: Latency,
    /// Processor time of proxies, bridges and switches per message in microseconds, or `None` if
    /// there are none.
    cpu_us: Option<f64>,
    /// Processor time of the machine per message in microseconds: both ends, all between them, and
    /// the kernel with its interrupts. `None` beside busy loops.
    machine_us: Option<f64>,
    /// Wake-ups of both proxies or bridges per message: the voluntary context switches of their
    /// threads.
    wakeups: Option<f64>,
    /// System calls of both per message, or `None` where the kernel does not count them.
    system_calls: Option<f64>,
}

#[derive(Serialize)]
pub struct Latency {
    pub p50: f64,
    p90: f64,
    p99: f64,
    max: f64,
}

impl PathRow {
    pub fn of(route: BenchRoute, cell: &Cell, sent: u64, all: &[Measured]) -> Self {
        let messages = || all.iter().flat_map(|measured| &measured.received);
        let mut sorted: Vec<Duration> = messages().map(|message| message.latency).collect();
        sorted.sort();
        let received = sorted.len() as u64;
        let at = |percent| peers::percentile(&sorted, percent).as_nanos() as f64 / 1000.0;
        let latency_us = Latency { p50: at(50.0), p90: at(90.0), p99: at(99.0), max: at(100.0) };
        let each = |total: Option<f64>| total.filter(|_| received > 0).map(|total| total / received as f64);
        let microseconds = |time: Duration| time.as_secs_f64() * 1e6;
        let cpu: Option<Duration> = all.iter().map(|measured| measured.cpu).sum();
        let cpu_us = each(cpu.map(microseconds));
        let machine: Duration = all.iter().map(|measured| measured.machine).sum();
        let machine_us = each((cell.hogs == 0).then(|| microseconds(machine)));
        let total = |of: fn(&Measured) -> Option<u64>| all.iter().map(of).sum::<Option<u64>>().map(|sum| sum as f64);
        let wakeups = each(total(|measured| measured.wakeups));
        let system_calls = each(total(|measured| measured.system_calls));
        let damaged = messages().filter(|message| !message.intact).count() as u64;
        let Load { bytes, rate, topics, vendor, .. } = cell.load;
        let vendor = vendor_name(route.ends(vendor));
        Self {
            route,
            cables: cell.name.clone(),
            hogs: cell.hogs,
            bytes,
            rate,
            topics,
            vendor,
            sent,
            received,
            damaged,
            latency_us,
            cpu_us,
            machine_us,
            wakeups,
            system_calls,
        }
    }
}

/// Measures these routes in turn, and returns a row for each.
pub fn measure_in_turn(
    bench: &Bench,
    cell: &Cell,
    routes: &[BenchRoute],
    (rounds, seconds): (u32, u32),
) -> Result<Vec<PathRow>> {
    let Cell { name, cables, hogs, load } = cell;
    let Load { bytes, rate, topics, .. } = load;
    let count = load.count(seconds);
    let mut samples: Vec<Vec<Measured>> = routes.iter().map(|_| Vec::new()).collect();
    for _ in 0..rounds {
        for (route, all) in routes.iter().zip(&mut samples) {
            let what = route.describe();
            eprintln!("{count} messages of {bytes} B at {rate} Hz on {topics} topics, {name}, {hogs} hogs: {what}");
            let _hogs = Hog::several(*hogs)?;
            all.push(bench.measure(*route, cables, load, count)?);
        }
    }
    let sent = count * u64::from(rounds);
    Ok(routes.iter().zip(&samples).map(|(route, all)| PathRow::of(*route, cell, sent, all)).collect())
}

fn vendor_name(vendor: Vendor) -> &'static str {
    match vendor {
        Vendor::Cyclone => "cyclone",
        Vendor::FastDds => "fastdds",
        Vendor::Tcp | Vendor::Quic | Vendor::QuicStreams => "none",
    }
}

pub fn print_table(rows: &[PathRow]) {
    println!(
        "Messages, one way, in microseconds. CPU: processor time of proxies, bridges and switches; machine: of all,"
    );
    println!("with the kernel's interrupts; wake-ups and system calls of both proxies or bridges: all per message");
    println!(
        "{:<36} {:>16} {:>4} {:>8} {:>8} {:>6} {:>6} {:>13} {:>8} {:>8} {:>8} {:>8} {:>7} {:>7} {:>8} {:>6}",
        "path",
        "cables",
        "hogs",
        "vendor",
        "bytes",
        "Hz",
        "topics",
        "recv/sent",
        "p50",
        "p90",
        "p99",
        "max",
        "CPU",
        "machine",
        "wake-ups",
        "calls"
    );
    for row in rows {
        let (l, got) = (&row.latency_us, format!("{}/{}", row.received, row.sent));
        let whole = |time: Option<f64>| time.map_or_else(|| "-".to_owned(), |time| format!("{time:.0}"));
        let each = |count: Option<f64>| count.map_or_else(|| "-".to_owned(), |count| format!("{count:.1}"));
        println!(
            "{:<36} {:>16} {:>4} {:>8} {:>8} {:>6} {:>6} {got:>13} {:>8.0} {:>8.0} {:>8.0} {:>8.0} {:>7} {:>7} {:>8} \
             {:>6}",
            row.route.describe(),
            row.cables,
            row.hogs,
            row.vendor,
            row.bytes,
            row.rate,
            row.topics,
            l.p50,
            l.p90,
            l.p99,
            l.max,
            whole(row.cpu_us),
            whole(row.machine_us),
            each(row.wakeups),
            each(row.system_calls)
        );
    }
}
