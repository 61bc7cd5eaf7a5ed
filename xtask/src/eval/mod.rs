//! `cargo xtask eval FIGURE`: the evaluation of the paper, made again on this system
//! (`docs/evaluation.md`).

mod bars;
mod fig5;
mod links;
mod plots;
mod quota;
mod raw;
mod ring;
mod roam;
mod site;
mod stages;
mod table1;
mod table_row;
mod tools;
mod trial;
mod workload;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use clap::ValueEnum as _;

use self::links::LinkKind;

#[derive(clap::Args)]
pub struct Options {
    #[command(subcommand)]
    figure: Evaluation,
}

#[derive(clap::Subcommand)]
enum Evaluation {
    /// Measure the one-way latency over the message size through three nodes, for every setup
    Fig5(fig5::Options),
    /// Run vSLAM, motion planning and grasp planning on the robot alone and on the edge
    Table1(table1::Options),
    /// Run vSLAM over five switches in a ring, while cables are cut and switches lose their power
    Ring(ring::Options),
    /// Run vSLAM on a robot that moves from one network to another, steered from ROS 1
    Roam(roam::Options),
    /// Run all of these, on all kinds of links
    All(AllOptions),
}

#[derive(clap::Args)]
struct AllOptions {
    /// Print JSON on stdout instead of tables
    #[arg(long)]
    json: bool,
    /// Draw plots into this folder
    #[arg(long)]
    plots: Option<PathBuf>,
    /// Measure little, and without zenoh's bridges, which build for ten minutes
    #[arg(long)]
    quick: bool,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    checked: bool,
}

pub fn run(options: Options) -> Result<()> {
    match options.figure {
        Evaluation::Fig5(options) => fig5::run(options),
        Evaluation::Table1(options) => table1::run(&options),
        Evaluation::Ring(options) => ring::run(&options),
        Evaluation::Roam(options) => roam::run(&options),
        Evaluation::All(options) => all(options),
    }
}

fn all(options: AllOptions) -> Result<()> {
    let AllOptions { json, plots, quick, checked } = options;
    let begun = Instant::now();
    let links = LinkKind::value_variants().to_vec();
    fig5::run(fig5::Options { json, plots: plots.clone(), rounds: 1, links, quick, checked })?;
    let (links, workloads, setups) = (Vec::new(), Vec::new(), Vec::new());
    table1::run(&table1::Options { json, plots, rounds: 1, quick, checked, links, workloads, setups })?;
    ring::run(&ring::Options { json, seed: ring::SEED, quick, checked })?;
    roam::run(&roam::Options { json, quick, checked })?;
    eprintln!("all of it took {:.1} minutes", begun.elapsed().as_secs_f64() / 60.0);
    Ok(())
}
