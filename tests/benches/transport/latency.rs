//! Latency of messages at a fixed rate over a bad link, from each due time to the arrival of the
//! complete, verified message.

use std::cell::RefCell;
use std::time::Duration;

use anyhow::Result;
use gdp_faults::{Faults, MILLISECOND};
use gdp_tests::measure::cpu;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, alternate};

use crate::lane::Load;
use crate::run::{self, Open};
use crate::site::{Cable, Site};
use crate::{Bench, ours, quic, tls};

/// Loads on one link. Only the first lane is evaluated.
struct Scenario {
    name: &'static str,
    title: &'static str,
    faults: Faults,
    cases: Vec<(&'static str, Vec<Load>)>,
    /// Aims of this SDK.
    aims: fn(Figure) -> Figure,
}

/// The transports; TCP and QUIC also with the congestion controller that suits lossy links.
const ON_BAD_LINKS: [(&str, Open); 6] = [
    (ours::BEST_EFFORT, ours::best_effort),
    (ours::RELIABLE, ours::reliable),
    (quic::CUBIC, quic::cubic),
    (quic::BBR, quic::bbr),
    (tls::CUBIC, tls::cubic),
    (tls::BBR, tls::bbr),
];

/// The lossy link: bits per second, nanoseconds, and its load.
const LOSSY_RATE: u64 = 1_000_000_000;
const LOSSY_RTT: u64 = 50 * MILLISECOND;
const LOSSY_BYTES: usize = 1_000_000;

/// The link that large and small messages share.
const MIXED_RATE: u64 = 500_000_000;
const LARGEST_FRAME: usize = 1514;

const MEDIAN: &str = "median";
const SLOW: &str = "99 %";

/// Small messages alone, and while large ones share the link.
const ALONE: &str = "alone";
const BESIDE: &str = "beside 10 MB at 10 Hz";

fn scenarios() -> Vec<Scenario> {
    let at = |bytes, hertz| Load { bytes, every: Some(Duration::from_secs(1) / hertz) };
    vec![
        Scenario {
            name: "transport-lossy",
            title: "1 MB at 10 Hz over a link of 1 Gb/s and 50 ms round trip that loses 1 %",
            faults: Faults {
                rate: Some(LOSSY_RATE),
                queue: Some(2_000_000),
                loss: 0.01,
                ..Faults::delay(LOSSY_RTT / 2)
            },
            cases: vec![("", vec![at(LOSSY_BYTES, 10)])],
            aims: |figure| {
                let serialization = (LOSSY_BYTES * 8) as f64 / LOSSY_RATE as f64;
                let most = 4.0 * milliseconds(LOSSY_RTT) + 1000.0 * serialization;
                figure.aim(ours::RELIABLE, SLOW, Aim::AtMost(most))
            },
        },
        Scenario {
            name: "transport-video",
            title: "1 MB at 30 Hz over a link of 10 ms round trip that loses 2 %",
            faults: Faults { loss: 0.02, ..Faults::delay(5 * MILLISECOND) },
            cases: vec![("", vec![at(1_000_000, 30)])],
            aims: |figure| figure,
        },
        Scenario {
            name: "transport-mixed",
            title: "64 B at 100 Hz on a link of 500 Mb/s",
            faults: Faults { rate: Some(MIXED_RATE), queue: Some(1_000_000), ..Faults::delay(MILLISECOND) },
            cases: vec![(ALONE, vec![at(64, 100)]), (BESIDE, vec![at(64, 100), at(10_000_000, 10)])],
            aims: |figure| [ours::BEST_EFFORT, ours::RELIABLE].into_iter().fold(figure, beside),
        },
    ]
}

/// Aim: twice the value on the idle link, plus the transmission time of one frame.
fn beside(figure: Figure, series: &str) -> Figure {
    let Some(alone) = figure.measure(series, &label(ALONE, SLOW)) else { return figure };
    let most = 2.0 * alone.spread.median + 1000.0 * (LARGEST_FRAME * 8) as f64 / MIXED_RATE as f64;
    figure.aim(series, &label(BESIDE, SLOW), Aim::AtMost(most))
}

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    scenarios().into_iter().map(|scenario| measure(scenario, bench)).collect()
}

fn measure(scenario: Scenario, bench: &Bench) -> Result<Figure> {
    let Scenario { name, title, faults, cases, aims } = scenario;
    let site = Site::build(Cable::Bad(faults), bench)?;
    let medians = RefCell::new(Vec::new());
    let mut contenders = Vec::new();
    for (case, loads) in &cases {
        for (series, open) in ON_BAD_LINKS {
            let (site, medians) = (&site, &medians);
            let (slow, median) = (label(case, SLOW), label(case, MEDIAN));
            contenders.push(Contender::new(series, slow, move || {
                let cpus = [cpu::SENDER, cpu::OTHER];
                let seen = run::run(site, open, loads, cpus, bench.long_duration())?;
                let lane = &seen.lanes[0];
                medians.borrow_mut().push((series, median.clone(), percentile(&lane.latencies, 50)));
                Ok(lane.sample(percentile(&lane.latencies, 99)))
            }));
        }
    }
    let measures = alternate(bench.rounds, contenders)?;
    site.check()?;
    let mut figure = Figure::new(name, title, Unit::Milliseconds, measures);
    for (series, _) in ON_BAD_LINKS {
        figure = figure.compare_with(series, (series, &label(ALONE, SLOW)), |_| None);
    }
    figure = aims(figure);
    let medians = medians.into_inner();
    for (case, _) in &cases {
        for (series, _) in ON_BAD_LINKS {
            let case = label(case, MEDIAN);
            let mine = medians.iter().filter(|(of, at, _)| *of == series && *at == case).map(|(.., value)| *value);
            // The first round warms up.
            let rounds = mine.skip(1).collect();
            figure.measures.push(Measure::new(series, case.clone(), rounds));
        }
    }
    Ok(figure)
}

fn label(case: &str, which: &str) -> String {
    if case.is_empty() { which.to_owned() } else { format!("{case}, {which}") }
}

/// Returns a percentile in milliseconds; without arrivals it is infinite.
fn percentile(sorted: &[u64], percent: usize) -> f64 {
    let index = sorted.len().saturating_sub(1) * percent / 100;
    sorted.get(index).map_or(f64::INFINITY, |nanoseconds| milliseconds(*nanoseconds))
}

fn milliseconds(nanoseconds: u64) -> f64 {
    nanoseconds as f64 / 1e6
}
