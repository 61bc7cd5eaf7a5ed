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
mod table1;
mod tools;
mod trial;
mod workload;

use anyhow::Result;

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
}

pub fn run(options: Options) -> Result<()> {
    match options.figure {
        Evaluation::Fig5(options) => fig5::run(options),
        Evaluation::Table1(options) => table1::run(&options),
        Evaluation::Ring(options) => ring::run(&options),
        Evaluation::Roam(options) => roam::run(&options),
    }
}
