//! Table I of the paper: vSLAM, motion planning and grasp planning, on the robot alone and on the
//! edge, over each network.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::ValueEnum as _;
use gdp_tests::wait;

use super::bars;
use super::links::LinkKind;
use super::plots;
use super::raw::RawRows;
use super::site::{Setup, Site};
use super::table_row::{TableRow, print_table};
use super::tools::EvalTools;
use super::trial::{Requests, RunningWorkload, Trial};
use super::workload::Workload;
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object a row on stdout instead of tables
    #[arg(long)]
    pub json: bool,
    /// Draw plots into this folder
    #[arg(long)]
    pub plots: Option<PathBuf>,
    /// Number of alternating measurements per setup
    #[arg(long, default_value_t = 1)]
    pub rounds: u32,
    /// Ask few requests, on plain links and without zenoh's bridges, which build for ten minutes
    #[arg(long)]
    pub quick: bool,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    pub checked: bool,
    /// Kind of links to measure; repeat for several. Default: all kinds
    #[arg(long = "links", value_enum)]
    pub links: Vec<LinkKind>,
    /// Workload to measure; repeat for several. Default: all
    #[arg(long = "workload", value_enum)]
    pub workloads: Vec<Workload>,
    /// Setup to measure; repeat for several. Default: all
    #[arg(long = "setup", value_enum)]
    pub setups: Vec<Setup>,
}

pub fn run(options: &Options) -> Result<()> {
    let workloads: Vec<Workload> = chosen(&options.workloads)
        .into_iter()
        .filter(|workload| !options.quick || *workload != Workload::GraspSmall)
        .collect();
    let links = match (&options.links[..], options.quick) {
        ([], true) => vec![LinkKind::Plain],
        ([], false) => LinkKind::value_variants().to_vec(),
        (chosen, _) => chosen.to_vec(),
    };
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    let tools = EvalTools::prepare(profile, options.setups_on(LinkKind::Plain).contains(&Setup::Zenoh))?;
    let mut raw = RawRows::create("table1")?;
    let mut rows = Vec::new();
    for links in links {
        for workload in workloads.iter().copied() {
            for round in 0..options.rounds.max(1) {
                for setup in options.setups_on(links) {
                    eprintln!("{}: {}, {} links", workload.describe(), setup.describe(), links.name());
                    let trial = measure(&tools, setup, links, workload, requests(workload, options.quick))?;
                    let row = TableRow { workload: workload.name(), of: workload, setup, links, round, trial };
                    raw.write(&row)?;
                    if options.json {
                        println!("{}", serde_json::to_string(&row)?);
                    }
                    rows.push(row);
                }
            }
        }
    }
    raw.finish();
    if !options.json {
        print_table(&rows);
        bars::of_table(&rows).iter().for_each(|bar| println!("{bar}"));
    }
    if let Some(folder) = &options.plots {
        plots::draw(&rows, folder)?;
    }
    bars::check(&rows)
}

impl Options {
    /// Returns the chosen setups whose network can have these links.
    fn setups_on(&self, links: LinkKind) -> Vec<Setup> {
        let is_quick = |setup: &Setup| !matches!(setup, Setup::Cable | Setup::Zenoh);
        let all = chosen(&self.setups).into_iter().filter(|setup| !self.quick || is_quick(setup));
        all.filter(|setup| links == LinkKind::Plain || setup.has_wire()).collect()
    }
}

/// Returns all values if none is chosen.
fn chosen<T: clap::ValueEnum>(values: &[T]) -> Vec<T> {
    if values.is_empty() { T::value_variants().to_vec() } else { values.to_vec() }
}

fn requests(workload: Workload, quick: bool) -> Requests {
    const SECONDS: f64 = 20.0;
    match (workload, quick) {
        (Workload::Slam, false) => Requests::for_seconds(SECONDS, false),
        (Workload::Slam, true) => Requests::for_seconds(SECONDS / 3.0, true),
        (_, false) => Requests { count: 20, ..Requests::for_seconds(0.0, false) },
        (_, true) => Requests { count: 4, ..Requests::for_seconds(0.0, true) },
    }
}

fn measure(tools: &EvalTools, setup: Setup, links: LinkKind, workload: Workload, requests: Requests) -> Result<Trial> {
    wait::check_interrupt()?;
    let folder = tempfile::Builder::new().prefix("gdp-eval-").tempdir().context("cannot create a folder")?;
    let site = Site::start(tools, setup, &links.cables(), workload.topics(), folder.path())?;
    RunningWorkload::start(tools, &site, workload, requests, folder.path())?.finish(&site)
}
