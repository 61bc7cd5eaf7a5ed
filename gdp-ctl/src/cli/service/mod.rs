//! `gdp-ctl service`: the counterpart of `ros2 service` in the fabric.

mod call;

use clap::Subcommand;

pub use call::CallOutput;

use super::topic::{ListOptions, list};
use crate::cli::context::Context;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// List the services of the keyring.
    List(ListOptions),
    /// Call a service, and print its response.
    Call(call::Options),
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::List(options) => list("service", &options, context),
        Command::Call(options) => call::run(&options, context),
    }
}
