//! `gdp-ctl action`: the counterpart of `ros2 action` in the fabric.

use clap::Subcommand;

use super::topic::{ListOptions, list};
use crate::cli::context::Context;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// List the actions of the keyring.
    List(ListOptions),
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::List(options) => list("action", &options, context),
    }
}
