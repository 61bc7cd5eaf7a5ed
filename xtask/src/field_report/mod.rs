//! `cargo xtask field-report`: the network part of the evaluation on a user's own two machines.
//!
//! - [`serve`]: the edge, with switch, proxy and echo programs; it writes one file for the robot
//! - [`measure`]: the robot, which asks and keeps the time; [`report`]: its table
//! - [`in_namespaces`]: both in two network namespaces of this machine, as a check of this verb
//! - [`robot_file`]: the file; [`nic`]: machines, interfaces; [`echo`]: the programs at both ends

mod echo;
mod in_namespaces;
mod measure;
mod nic;
mod report;
mod robot_file;
mod serve;

use anyhow::Result;

#[derive(clap::Args)]
pub struct Options {
    #[command(subcommand)]
    step: ReportStep,
}

#[derive(clap::Subcommand)]
enum ReportStep {
    /// Run the edge until Ctrl-C, and write the file that the robot needs (needs root)
    Serve(serve::Options),
    /// Measure from the robot to the edge, and print the table to send in
    Measure(measure::Options),
    /// Run both in two network namespaces of this machine, to check this verb (needs root)
    Try(in_namespaces::Options),
}

pub fn run(options: Options) -> Result<()> {
    match options.step {
        ReportStep::Serve(options) => serve::run(&options),
        ReportStep::Measure(options) => measure::run(&options),
        ReportStep::Try(options) => in_namespaces::run(&options),
    }
}
