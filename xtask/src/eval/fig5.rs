//! Figure 5 of the paper: one-way latency over the message size, through three nodes between two
//! hosts.
//!
//! The ends are one ROS 2 publisher and one subscriber (Cyclone DDS or Fast DDS, reliable,
//! unmodified). The setups differ in what is between them: `bench::paths` has them. A round
//! measures all setups, and every other round does so in reverse order. `links` has the kinds of
//! links.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use gdp_tests::measure::Wanted;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::report;

use super::links::LinkKind;
use super::raw::RawRows;
use crate::bench::paths::{Bench, BenchRoute, Cables, Cell, LOAD, Load, PathRow};
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of tables
    #[arg(long)]
    pub(super) json: bool,
    /// Draw plots into this folder
    #[arg(long)]
    pub(super) plots: Option<PathBuf>,
    /// Number of alternating measurements per setup
    #[arg(long, default_value_t = 3)]
    pub(super) rounds: usize,
    /// Kind of links to measure; repeat for several
    #[arg(long, value_enum, default_values_t = [LinkKind::Plain])]
    pub(super) links: Vec<LinkKind>,
    /// Measure two sizes once on plain links, and only setups that start quickly
    #[arg(long)]
    pub(super) quick: bool,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    pub(super) checked: bool,
}

const SETUPS: [BenchRoute; 9] = [
    BenchRoute::Local,
    BenchRoute::Cable,
    BenchRoute::Ip,
    BenchRoute::FastDds,
    BenchRoute::FastDdsSecured,
    BenchRoute::ZenohTls,
    BenchRoute::Gdp,
    BenchRoute::GdpUdp,
    BenchRoute::GdpNat,
];
/// Zenoh's bridges build for ten minutes.
const QUICK_SETUPS: [BenchRoute; 5] =
    [BenchRoute::Cable, BenchRoute::Ip, BenchRoute::Gdp, BenchRoute::GdpUdp, BenchRoute::GdpNat];

/// This system's setups that have bars: through three nodes, as the others.
const OURS: [BenchRoute; 2] = [BenchRoute::Gdp, BenchRoute::GdpUdp];

const SIZES: [usize; 8] = [64, 1_000, 8_000, 64_000, 256_000, 1_000_000, 4_000_000, 8_000_000];
const QUICK_SIZES: [usize; 2] = [64, 1_000_000];

/// Messages of one setup, size and round.
const COUNT: u64 = 30;

/// Rate of small messages, in messages per second. Large ones come at `MOST_BYTES` per second.
const RATE: f64 = 20.0;
const MOST_BYTES: f64 = 24e6;

/// What the paper's system adds to ROS 2 through three nodes, in milliseconds, on average.
const PAPER_ADDS: f64 = 14.0;
const PAPER: &str = "ROS 2, 3 routers + 14 ms";

/// The bar of what this system may add: a tenth.
const MAY_ADD: f64 = PAPER_ADDS / 10.0;

fn series(route: BenchRoute) -> &'static str {
    match route {
        BenchRoute::Local => "ROS 2, one host",
        BenchRoute::Cable => "ROS 2, one network",
        BenchRoute::Ip => "ROS 2, 3 routers",
        BenchRoute::FastDds => "Fast DDS, 3 routers",
        BenchRoute::FastDdsSecured => "Fast DDS Security",
        BenchRoute::ZenohTls => "zenoh bridges, TLS",
        BenchRoute::Gdp => "GDP, Ethernet",
        BenchRoute::GdpUdp => "GDP, UDP",
        BenchRoute::GdpNat => "GDP, two NATs and domains",
        other => other.describe(),
    }
}

fn figure_name(links: LinkKind) -> &'static str {
    match links {
        LinkKind::Plain => "eval-fig5",
        LinkKind::Gigabit => "eval-fig5-gigabit",
        LinkKind::Wifi => "eval-fig5-wifi",
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
    let (setups, sizes, rounds, links) = match options.quick {
        true => (&QUICK_SETUPS[..], &QUICK_SIZES[..], 1, &[LinkKind::Plain][..]),
        false => (&SETUPS[..], &SIZES[..], options.rounds.max(1), &options.links[..]),
    };
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    let bench = Bench::prepare(setups, profile)?;
    let mut raw = RawRows::create("fig5")?;
    let (mut figures, mut absent) = (Vec::new(), Vec::new());
    for kind in links {
        let on_links = OnLinks::of(*kind, setups);
        let mut latency = Vec::new();
        for bytes in sizes {
            latency.extend(on_links.measure(&bench, *bytes, rounds, &mut raw)?);
        }
        let figure = on_links.figure(latency, sizes);
        absent.extend(on_links.absent(&figure, sizes));
        figures.push(figure);
    }
    raw.finish();
    absent.iter().for_each(|line| eprintln!("{line}"));
    let wanted = Wanted { only: &[], json: options.json, plots: options.plots.as_deref() };
    report(figures, &wanted)
}

/// The setups on one kind of links.
struct OnLinks {
    kind: LinkKind,
    cables: Cables,
    setups: Vec<BenchRoute>,
    /// Setups without a cable that could be of this kind.
    without: Vec<BenchRoute>,
}

impl OnLinks {
    fn of(kind: LinkKind, setups: &[BenchRoute]) -> Self {
        let is_possible = |route: &&BenchRoute| kind == LinkKind::Plain || route.has_cables();
        let (setups, without) = setups.iter().partition(is_possible);
        Self { kind, cables: kind.cables(), setups, without }
    }

    /// Measures all setups with messages of one size: their medians, and on plain links those of
    /// the paper's system.
    fn measure(&self, bench: &Bench, bytes: usize, rounds: usize, raw: &mut RawRows) -> Result<Vec<Measure>> {
        let load = Load { bytes, rate: (MOST_BYTES / bytes as f64).min(RATE), ..LOAD };
        let (name, cables) = (self.kind.name().to_owned(), self.cables.clone());
        let cell = Cell { name, cables, hogs: 0, load };
        let mut medians: Vec<Vec<f64>> = self.setups.iter().map(|_| Vec::new()).collect();
        let mut lost = vec![0; self.setups.len()];
        for round in 0..rounds {
            let mut order: Vec<usize> = (0..self.setups.len()).collect();
            if round % 2 == 1 {
                order.reverse();
            }
            for at in order {
                let route = self.setups[at];
                let what = format!("{} of {} on {} links", series(route), case(bytes), cell.name);
                eprintln!("round {round}: {what}");
                let measured = bench.measure(route, &cell.cables, &cell.load, COUNT)?;
                let row = PathRow::of(route, &cell, COUNT, &[measured]);
                raw.write(&row)?;
                lost[at] += row.sent - row.received.min(row.sent);
                if row.received > 0 {
                    medians[at].push(row.latency_us.p50 / 1000.0);
                }
                // The bars would not notice a setup that is missing.
                ensure!(row.received > 0 || !OURS.contains(&route), "nothing arrived: {what}");
            }
        }
        let sent = (COUNT * rounds as u64) as f64;
        let setups = self.setups.iter().zip(medians).zip(lost);
        let mut measures: Vec<Measure> = setups
            .filter(|((_, medians), _)| medians.len() == rounds)
            .map(|((route, medians), lost)| Measure {
                lost_percent: Some(100.0 * lost as f64 / sent),
                ..Measure::new(series(*route), case(bytes), medians)
            })
            .collect();
        if self.kind == LinkKind::Plain
            && let Some(routers) = measures.iter().find(|measure| measure.series == series(BenchRoute::Ip))
        {
            let with = routers.rounds.iter().map(|median| median + PAPER_ADDS).collect();
            measures.push(Measure::new(PAPER, case(bytes), with));
        }
        Ok(measures)
    }

    /// Returns the figure. On plain links it has the bars: a tenth of what the paper's system adds,
    /// and not slower than zenoh.
    fn figure(&self, latency: Vec<Measure>, sizes: &[usize]) -> Figure {
        let mut title = "Figure 5: one-way latency through three nodes, median".to_owned();
        if self.kind != LinkKind::Plain {
            title += &format!("; {} before the cloud", self.kind.name());
        }
        let mut figure = Figure::new(figure_name(self.kind), title, Unit::Milliseconds, latency);
        for ours in OURS.map(series) {
            let is_plain = self.kind == LinkKind::Plain;
            for case in sizes.iter().map(|bytes| case(*bytes)).filter(|_| is_plain) {
                let routers = figure.measure(series(BenchRoute::Ip), &case).map(|measure| measure.spread.median);
                let is_complete = figure.measure(ours, &case).is_some_and(|measure| measure.lost_percent == Some(0.0));
                if let Some(routers) = routers {
                    // What loses messages has no latency that counts.
                    let most = if is_complete { routers + MAY_ADD } else { 0.0 };
                    figure = figure.aim(ours, &case, Aim::AtMost(most));
                }
            }
            figure = figure.compare(ours, series(BenchRoute::ZenohTls), |_| is_plain.then_some(Aim::AtMost(1.0)));
        }
        figure
    }

    /// Says what the figure does not have: setups without such a cable, and those of which a round
    /// had no message that arrived.
    fn absent(&self, figure: &Figure, sizes: &[usize]) -> Vec<String> {
        let kind = self.kind.name();
        let without = self.without.iter().map(|route| format!("{}: not measured on {kind} links", series(*route)));
        let all = sizes.iter().flat_map(|bytes| self.setups.iter().map(|route| (series(*route), case(*bytes))));
        let missing = all.filter(|(series, case)| figure.measure(series, case).is_none());
        without.chain(missing.map(|(series, case)| format!("{series}: no {case} arrived on {kind} links"))).collect()
    }
}
