//! Bytes per second of messages of one size, each sent as soon as the previous one is accepted.
//! Also the CPU time of both ends per gigabyte. Only complete messages count.

use std::cell::RefCell;

use anyhow::Result;
use gdp_tests::measure::cpu;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, alternate};

use crate::lane::Load;
use crate::site::{Cable, Site};
use crate::{Bench, TRANSPORTS, ours, quic, run, tls};

/// Bytes of a message.
const SIZES: [(&str, usize); 6] =
    [("64 B", 64), ("1 kB", 1_000), ("8 kB", 8_000), ("64 kB", 64_000), ("1 MB", 1_000_000), ("10 MB", 10_000_000)];

/// From this size in bytes on, the aim is to be faster than QUIC.
const LARGE: usize = 64_000;

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let site = Site::build(Cable::Plain, bench)?;
    let costs = RefCell::new(Vec::new());
    let mut contenders = Vec::new();
    for (case, bytes) in SIZES {
        for (series, open) in TRANSPORTS {
            let (site, costs) = (&site, &costs);
            contenders.push(Contender::new(series, case, move || {
                let load = Load { bytes, every: None };
                let seen = run::run(site, open, &[load], [cpu::SENDER, cpu::OTHER], bench.duration())?;
                let lane = &seen.lanes[0];
                costs.borrow_mut().push((series, case, 1e9 * seen.cpus / lane.bytes_per_second));
                Ok(lane.sample(lane.bytes_per_second))
            }));
        }
    }
    let measures = alternate(bench.rounds, contenders)?;
    site.check()?;
    let costs = costs.into_inner();
    let costs = SIZES.iter().flat_map(|(case, _)| TRANSPORTS.map(|(series, _)| (series, *case))).filter_map(|of| {
        let rounds = costs.iter().filter(|(series, case, _)| (*series, *case) == of).map(|(.., cost)| *cost);
        // The first round warms up. Without arrivals there is no cost per gigabyte.
        let rounds: Vec<f64> = rounds.skip(1).collect();
        rounds.iter().all(|cost| cost.is_finite()).then(|| Measure::new(of.0, of.1, rounds))
    });
    let costs = costs.collect();
    let ahead = |case: &str| {
        let bytes = SIZES.iter().find(|(name, _)| *name == case).map_or(0, |(_, bytes)| *bytes);
        (bytes >= LARGE).then_some(Aim::AtLeast(1.0))
    };
    let title = "Messages through one switch, or router, as fast as they are taken";
    let throughput = Figure::new("transport-throughput", title, Unit::BytesPerSecond, measures)
        .compare(ours::BEST_EFFORT, quic::CUBIC, ahead)
        .compare(ours::RELIABLE, quic::CUBIC, ahead)
        .compare(ours::ETHERNET, quic::CUBIC, |_| None)
        .compare(ours::BEST_EFFORT, tls::CUBIC, |_| None)
        .compare(ours::RELIABLE, tls::CUBIC, |_| None);
    let cost = Figure::new("transport-cpu", "CPU time of both ends", Unit::SecondsPerGigabyte, costs)
        .compare(ours::BEST_EFFORT, quic::CUBIC, |_| None)
        .compare(ours::RELIABLE, quic::CUBIC, |_| None)
        .compare(ours::ETHERNET, quic::CUBIC, |_| None)
        .compare(ours::BEST_EFFORT, tls::CUBIC, |_| None)
        .compare(ours::RELIABLE, tls::CUBIC, |_| None);
    Ok(vec![throughput, cost])
}
