//! How long messages take that come at a fixed rate over a bad link: from when each was due to when it was there, in one piece and
//! verified.

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

/// Loads on one link. The first lane is looked at.
struct Scenario {
    name: &'static str,
    title: &'static str,
    faults: Faults,
    cases: Vec<(&'static str, Vec<Load>)>,
}

/// Who carries messages; the others also by the controller that suits links that lose.
const ON_BAD_LINKS: [(&str, Open); 5] = [
    (ours::BEST_EFFORT, ours::best_effort),
    (quic::CUBIC, quic::cubic),
    (quic::BBR, quic::bbr),
    (tls::CUBIC, tls::cubic),
    (tls::BBR, tls::bbr),
];

const MEDIAN: &str = "median";
const SLOW: &str = "99 %";

/// Small messages by themselves, and beside large ones.
const ALONE: &str = "alone";
const BESIDE: &str = "beside 10 MB at 10 Hz";

fn scenarios() -> Vec<Scenario> {
    let at = |bytes, hertz| Load { bytes, every: Some(Duration::from_secs(1) / hertz) };
    vec![
        Scenario {
            name: "transport-lossy",
            title: "1 MB at 10 Hz over a link of 50 ms round trip that loses 1 %",
            faults: Faults { loss: 0.01, ..Faults::delay(25 * MILLISECOND) },
            cases: vec![("", vec![at(1_000_000, 10)])],
        },
        Scenario {
            name: "transport-video",
            title: "1 MB at 30 Hz over a link of 10 ms round trip that loses 2 %",
            faults: Faults { loss: 0.02, ..Faults::delay(5 * MILLISECOND) },
            cases: vec![("", vec![at(1_000_000, 30)])],
        },
        Scenario {
            name: "transport-mixed",
            title: "64 B at 100 Hz on a link of 500 Mb/s",
            faults: Faults { rate: Some(500_000_000), queue: Some(1_000_000), ..Faults::delay(MILLISECOND) },
            cases: vec![(ALONE, vec![at(64, 100)]), (BESIDE, vec![at(64, 100), at(10_000_000, 10)])],
        },
    ]
}

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    scenarios().into_iter().map(|scenario| measure(scenario, bench)).collect()
}

fn measure(scenario: Scenario, bench: &Bench) -> Result<Figure> {
    let Scenario { name, title, faults, cases } = scenario;
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
        figure = figure.compare_with(series, (series, &label(ALONE, SLOW)), |_| Some(Aim::AtMost(2.0)));
    }
    let medians = medians.into_inner();
    for (case, _) in &cases {
        for (series, _) in ON_BAD_LINKS {
            let case = label(case, MEDIAN);
            let mine = medians.iter().filter(|(of, at, _)| *of == series && *at == case).map(|(.., value)| *value);
            // The first was to warm up.
            let rounds = mine.skip(1).collect();
            figure.measures.push(Measure::new(series, case.clone(), rounds));
        }
    }
    Ok(figure)
}

fn label(case: &str, which: &str) -> String {
    if case.is_empty() { which.to_owned() } else { format!("{case}, {which}") }
}

/// In milliseconds. What never arrives takes for ever.
fn percentile(sorted: &[u64], percent: usize) -> f64 {
    let index = sorted.len().saturating_sub(1) * percent / 100;
    sorted.get(index).map_or(f64::INFINITY, |nanoseconds| *nanoseconds as f64 / 1e6)
}
