//! vSLAM over five switches in a ring, while cables are cut and switches lose their power.

use std::fmt;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use gdp_faults::Random;
use gdp_tests::ring::{Ring, SWITCHES};
use gdp_tests::wait;
use serde::Serialize;
use serde_json::json;

use super::raw;
use super::site::{Network, Site};
use super::tools::EvalTools;
use super::trial::{Requests, RunningWorkload, monotonic, slowest_since};
use super::workload::Workload;
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object a row on stdout instead of tables
    #[arg(long)]
    pub json: bool,
    /// Choose the faults by this number
    #[arg(long, default_value_t = SEED)]
    pub seed: u64,
    /// Cause two faults instead of six
    #[arg(long)]
    pub quick: bool,
    /// Run programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    pub checked: bool,
}

pub const SEED: u64 = 1;

/// How long a fault lasts, and how long the ring is whole after it.
const FAULT: Duration = Duration::from_secs(3);
const PAUSE: Duration = Duration::from_secs(3);

/// Something that happens to the ring. Switches count from 0 here, and from 1 in what is printed.
#[derive(Clone, Copy, PartialEq, Eq)]
enum RingFault {
    /// The cable between this switch and the next is cut.
    Cut(usize),
    /// This switch and its daemon lose their power.
    PowerLoss(usize),
}

impl RingFault {
    /// The cables, and the switches that have neither robot, cloud nor RIB.
    const ALL: [Self; 7] =
        [Self::Cut(0), Self::Cut(1), Self::Cut(2), Self::Cut(3), Self::Cut(4), Self::PowerLoss(1), Self::PowerLoss(3)];

    /// Returns faults in an order that the seed decides. At least every other one is on the path
    /// that traffic takes in a whole ring.
    fn schedule(seed: u64, count: usize) -> Vec<Self> {
        const ON_PATH: [RingFault; 3] = [RingFault::Cut(0), RingFault::Cut(1), RingFault::PowerLoss(1)];
        let mut random = Random::new(seed);
        let mut pick = |of: &[Self]| of[random.number() as usize % of.len()];
        (0..count).map(|i| if i % 2 == 0 { pick(&ON_PATH) } else { pick(&Self::ALL) }).collect()
    }

    fn begin(self, ring: &mut Ring) -> Result<()> {
        match self {
            Self::Cut(i) => ring.set_cable(i, false),
            Self::PowerLoss(i) => ring.power_off(i),
        }
    }

    /// Returns whether a path crosses neither this cable nor this switch.
    fn is_avoided_by(self, path: &[usize]) -> bool {
        match self {
            Self::Cut(i) => {
                let ends = [i, (i + 1) % SWITCHES];
                path.windows(2).all(|hop| hop.iter().any(|switch| !ends.contains(switch)))
            }
            Self::PowerLoss(i) => !path.contains(&i),
        }
    }

    fn end(self, ring: &mut Ring) -> Result<()> {
        match self {
            Self::Cut(i) => ring.set_cable(i, true),
            Self::PowerLoss(i) => ring.power_on(i),
        }
    }
}

impl fmt::Display for RingFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cut(i) => write!(f, "cable s{} to s{} cut", i + 1, (i + 1) % SWITCHES + 1),
            Self::PowerLoss(i) => write!(f, "s{} without power", i + 1),
        }
    }
}

/// What a fault did.
#[derive(Serialize)]
struct FaultRow {
    fault: String,
    /// Switches from robot to edge before the fault, during it, and after it.
    before: Vec<usize>,
    during: Vec<usize>,
    after: Vec<usize>,
    /// The longest time that an image took to the edge since the fault began, in milliseconds.
    slowest_ms: f64,
}

pub fn run(options: &Options) -> Result<()> {
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    let tools = EvalTools::prepare(profile, false)?;
    let faults = RingFault::schedule(options.seed, if options.quick { 2 } else { 6 });
    let folder = tempfile::Builder::new().prefix("gdp-eval-").tempdir().context("cannot create a folder")?;
    let mut site = Site::ring(&tools, Workload::Slam.topics())?;
    let seconds = (FAULT + PAUSE).as_secs_f64() * (faults.len() as f64) + 3.0;
    let requests = Requests::for_seconds(seconds, options.quick);
    let running = RunningWorkload::start(&tools, &site, Workload::Slam, requests, folder.path())?;
    wait::sleep(PAUSE)?;
    let mut rows = Vec::new();
    for fault in faults {
        eprintln!("{fault}");
        rows.push(endure(fault, &mut site, &running)?);
    }
    let trial = running.finish(&site)?;
    let repeated = frames_sent_again(&site);
    let summary = json!({"seed": options.seed, "frames_sent_again": repeated, "trial": trial});
    raw::write_all("ring", &rows, &summary, options.json)?;
    if !options.json {
        print(&rows);
        println!(
            "{} of {} images answered, {} damaged, {repeated} frames sent again; {}",
            trial.requests - trial.lost,
            trial.requests,
            trial.damaged,
            Workload::Slam.result(&trial.result)
        );
    }
    trial.check(Workload::Slam)
}

/// Lets a fault happen and pass.
fn endure(fault: RingFault, site: &mut Site, running: &RunningWorkload) -> Result<FaultRow> {
    let since = monotonic()?;
    let before = ring(site)?.path()?;
    fault.begin(ring(site)?)?;
    wait::sleep(FAULT)?;
    ring(site)?.wait("a path that avoids the fault", |ring| Ok(fault.is_avoided_by(&ring.path()?)))?;
    let during = ring(site)?.path()?;
    fault.end(ring(site)?)?;
    wait::sleep(PAUSE)?;
    ring(site)?.wait("the path of before", |ring| Ok(ring.path()? == before))?;
    let after = ring(site)?.path()?;
    let slowest = slowest_since(&running.exchanges(), since)?;
    Ok(FaultRow { fault: fault.to_string(), before, during, after, slowest_ms: slowest.as_secs_f64() * 1e3 })
}

/// Returns the frames that the robot's proxy sent again, by its latest statistics.
fn frames_sent_again(site: &Site) -> u64 {
    let Some([robot, _]) = site.proxy_stats() else { return 0 };
    let topics = robot["topics"].as_array().into_iter().flatten();
    topics.filter_map(|topic| topic["fabric"]["repeated"].as_u64()).sum()
}

fn ring(site: &mut Site) -> Result<&mut Ring> {
    match &mut site.network {
        Network::Ring(ring) => Ok(ring),
        _ => bail!("not a ring"),
    }
}

fn print(rows: &[FaultRow]) {
    let path = |path: &[usize]| path.iter().map(|i| format!("s{}", i + 1)).collect::<Vec<_>>().join(" ");
    println!("| fault | path before | during | after | slowest image |\n|{}", " --- |".repeat(5));
    for FaultRow { fault, before, during, after, slowest_ms } in rows {
        let [before, during, after] = [before, during, after].map(|it| path(it));
        println!("| {fault} | {before} | {during} | {after} | {slowest_ms:.0} ms |");
    }
}
