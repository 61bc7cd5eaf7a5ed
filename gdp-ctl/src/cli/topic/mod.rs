//! `gdp-ctl topic`: the counterpart of `ros2 topic` in the fabric.

mod echo;
mod info;
mod list;
mod measure;
mod publish;

use anyhow::Result;
use clap::Subcommand;

use crate::cli::context::Context;

pub use echo::EchoOutput;
pub use info::InfoOutput;
pub use list::{ListOptions, ListOutput, list};
pub use measure::{BandwidthOutput, DelayOutput, RateOutput};
pub use publish::PublishOutput;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// List the topics of the keyring.
    List(ListOptions),
    /// Show a topic's type, publishers and readers.
    Info(info::Options),
    /// Print a topic's messages.
    Echo(echo::Options),
    /// Show how often messages come.
    Hz(measure::Options),
    /// Show how many bytes come: of what travels compressed, those that it was before.
    Bw(measure::Options),
    /// Show how old messages are when they come, by the stamps of their headers; without these, by
    /// when they were sent.
    Delay(measure::DelayOptions),
    /// Publish a topic. ROS nodes behind proxies see it like any other publisher.
    Pub(publish::Options),
}

pub fn run(command: Command, context: &Context) -> Result<()> {
    match command {
        Command::List(options) => list("topic", &options, context),
        Command::Info(options) => info::run(&options, context),
        Command::Echo(options) => echo::run(&options, context),
        Command::Hz(options) => measure::hz(&options, context),
        Command::Bw(options) => measure::bw(&options, context),
        Command::Delay(options) => measure::delay(&options, context),
        Command::Pub(options) => publish::run(&options, context),
    }
}
