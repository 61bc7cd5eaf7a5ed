//! `gdp-ctl service`: what `ros2 service` is in a ROS graph, in the fabric.

use clap::Subcommand;

use super::Context;
use super::topic::{ListOptions, list};

#[derive(Debug, Subcommand)]
pub enum Command {
    /// List the services of the keyring.
    List(ListOptions),
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::List(options) => list("service", &options, context),
    }
}
