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
    /// Measure the rate of a topic's messages.
    Hz(measure::Options),
    /// Measure the bandwidth of a topic. Compressed messages count with their size before
    /// compression.
    Bw(measure::Options),
    /// Measure the age of messages on arrival, from the stamps in their headers. Messages without a
    /// stamp count from their send time.
    Delay(measure::DelayOptions),
    /// Publish a topic. To ROS nodes behind proxies, it appears as any other publisher.
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
