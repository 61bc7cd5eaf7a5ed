//! Figure 5 of the paper: one-way latency over the message size, through three nodes between two
//! hosts.
//!
//! The ends are one ROS 2 publisher and one subscriber (Cyclone DDS, reliable, unmodified). The
//! setups differ in what is between them: `bench::paths` has them. A round measures all setups, and
//! every other round does so in reverse order.

use std::fs::File;
use std::io::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use gdp_tests::measure::Wanted;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::report;

use crate::bench::paths::{Bench, BenchRoute, Cables, Cell, LOAD, Load, PathRow};
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of tables
    #[arg(long)]
    json: bool,
    /// Draw plots into this folder
    #[arg(long)]
    plots: Option<PathBuf>,
    /// Number of alternating measurements per setup
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    /// Measure two sizes once, without zenoh's bridges, which build for ten minutes
    #[arg(long)]
    quick: bool,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    checked: bool,
}

const SETUPS: [BenchRoute; 5] =
    [BenchRoute::Local, BenchRoute::Ip, BenchRoute::ZenohTls, BenchRoute::Gdp, BenchRoute::GdpUdp];

const SIZES: [usize; 8] = [64, 1_000, 8_000, 64_000, 256_000, 1_000_000, 4_000_000, 8_000_000];
const QUICK_SIZES: [usize; 2] = [64, 1_000_000];

/// Messages of one setup, size and round.
const COUNT: u64 = 30;

/// Rate of small messages, in messages per second. Large ones come at `MOST_BYTES` per second.
const RATE: f64 = 10.0;
const MOST_BYTES: f64 = 24e6;

/// What the paper's system adds to ROS 2 through three nodes, in milliseconds, on average.
const PAPER_ADDS: f64 = 14.0;
const PAPER: &str = "ROS 2, 3 routers + 14 ms";

/// The bar of what this system may add: a tenth.
const MAY_ADD: f64 = PAPER_ADDS / 10.0;

fn series(route: BenchRoute) -> &'static str {
    match route {
        BenchRoute::Local => "ROS 2, one host",
        BenchRoute::Ip => "ROS 2, 3 routers",
        BenchRoute::ZenohTls => "zenoh bridges, TLS",
        BenchRoute::Gdp => "GDP, Ethernet",
        BenchRoute::GdpUdp => "GDP, UDP",
        other => other.describe(),
    }
}

fn case(bytes: usize) -> String {
    match bytes {
        1_000_000.. => format!("{} MB", bytes / 1_000_000),
        1_000.. => format!("{} kB", bytes / 1_000),
        _ => format!("{bytes} B"),
    }
}

pub fn run(options: Options) -> Result<()> {
    let quick = options.quick;
    let setups: Vec<BenchRoute> = SETUPS.into_iter().filter(|route| !quick || *route != BenchRoute::ZenohTls).collect();
    let (sizes, rounds) = if quick { (&QUICK_SIZES[..], 1) } else { (&SIZES[..], options.rounds.max(1)) };
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    let bench = Bench::prepare(&setups, profile)?;
    let mut raw = Raw::create()?;
    let mut latency = Vec::new();
    for bytes in sizes {
        latency.extend(measure(&bench, &setups, *bytes, rounds, &mut raw)?);
    }
    eprintln!("all rows: {}", raw.path.display());
    let wanted = Wanted { only: &[], json: options.json, plots: options.plots.as_deref() };
    report(vec![figure(latency, sizes)], &wanted)
}

/// Measures all setups with messages of one size: their medians, and those of the paper's system.
fn measure(bench: &Bench, setups: &[BenchRoute], bytes: usize, rounds: usize, raw: &mut Raw) -> Result<Vec<Measure>> {
    let load = Load { bytes, rate: (MOST_BYTES / bytes as f64).min(RATE), ..LOAD };
    let cell = Cell { name: "plain".to_owned(), cables: Cables::default(), hogs: 0, load };
    let mut medians: Vec<Vec<f64>> = setups.iter().map(|_| Vec::new()).collect();
    let mut lost = vec![0; setups.len()];
    for round in 0..rounds {
        let mut order: Vec<usize> = (0..setups.len()).collect();
        if round % 2 == 1 {
            order.reverse();
        }
        for at in order {
            eprintln!("round {round}: {} of {}", series(setups[at]), case(bytes));
            let measured = bench.measure(setups[at], &cell.cables, &cell.load, COUNT)?;
            let row = PathRow::of(setups[at], &cell, COUNT, &[measured]);
            raw.write(&row)?;
            ensure!(row.received > 0, "nothing arrived: {}, {}", series(setups[at]), case(bytes));
            medians[at].push(row.latency_us.p50 / 1000.0);
            lost[at] += row.sent - row.received.min(row.sent);
        }
    }
    let routers =
        setups.iter().position(|route| *route == BenchRoute::Ip).map(|at| medians[at].clone()).unwrap_or_default();
    let sent = (COUNT * rounds as u64) as f64;
    let measures = setups.iter().zip(medians).zip(lost).map(|((route, medians), lost)| Measure {
        lost_percent: Some(100.0 * lost as f64 / sent),
        ..Measure::new(series(*route), case(bytes), medians)
    });
    let paper = Measure::new(PAPER, case(bytes), routers.iter().map(|median| median + PAPER_ADDS).collect());
    Ok(measures.chain([paper]).collect())
}

/// Returns the figure, with the bars: a tenth of what the paper's system adds, and not slower than
/// zenoh.
fn figure(latency: Vec<Measure>, sizes: &[usize]) -> Figure {
    let title = "Figure 5: one-way latency through three nodes, median";
    let mut figure = Figure::new("eval-fig5", title, Unit::Milliseconds, latency);
    for ours in [BenchRoute::Gdp, BenchRoute::GdpUdp].map(series) {
        for case in sizes.iter().map(|bytes| case(*bytes)) {
            let routers = figure.measure(series(BenchRoute::Ip), &case).map(|measure| measure.spread.median);
            let is_complete = figure.measure(ours, &case).is_some_and(|measure| measure.lost_percent == Some(0.0));
            if let Some(routers) = routers {
                // What loses messages has no latency that counts.
                let most = if is_complete { routers + MAY_ADD } else { 0.0 };
                figure = figure.aim(ours, &case, Aim::AtMost(most));
            }
        }
        figure = figure.compare(ours, series(BenchRoute::ZenohTls), |_| Some(Aim::AtMost(1.0)));
    }
    figure
}

/// The measured rows as JSON lines, in `target/eval`.
struct Raw {
    path: PathBuf,
    file: File,
}

impl Raw {
    fn create() -> Result<Self> {
        let folder = workspace::target().join("eval");
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
        let path = folder.join("fig5.jsonl");
        let file = File::create(&path).with_context(|| format!("cannot create {}", path.display()))?;
        Ok(Self { path, file })
    }

    fn write(&mut self, row: &PathRow) -> Result<()> {
        let line = serde_json::to_string(row)?;
        writeln!(self.file, "{line}").with_context(|| format!("cannot write {}", self.path.display()))
    }
}
