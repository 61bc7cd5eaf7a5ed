//! `cargo xtask bench NAME [--json]`: measures the figures in `docs/benchmarks`, one file for each.
//!
//! The compared alternatives are measured in one run under the same conditions, in turn, so that a
//! busy machine slows all of them.

mod control;
mod forward;
mod latency;
mod local;
mod program;
mod ros;
mod transport;

use anyhow::Result;

#[derive(clap::Args)]
pub struct Options {
    #[command(subcommand)]
    figure: Figure,
}

#[derive(clap::Subcommand)]
enum Figure {
    /// One-way latency, DDS to DDS: over three XDP switches, beside the same programs over three IP
    /// routers
    Latency(latency::Options),
    /// Cost of forwarding: XDP beside a bare redirect, the kernel's IPv4 routers and a forwarder on
    /// packet sockets
    Forward(forward::Options),
    /// Control plane: statements and queries per second, memory per name, recovery after a cut,
    /// reconciliation
    Control(control::Options),
    /// Between two endpoints on the switch's host: through the daemon, on packet sockets, past both
    Local(local::Options),
    /// ROS 2 messages through two proxies: latency and processor time, beside kernel routers and
    /// two zenoh bridges
    Ros(ros::Options),
    /// Throughput, CPU time and latency of messages: this SDK beside quinn and TLS over TCP
    Transport(transport::Options),
}

pub fn run(options: Options) -> Result<()> {
    match options.figure {
        Figure::Latency(options) => latency::run(options),
        Figure::Forward(options) => forward::run(options),
        Figure::Control(options) => control::run(options),
        Figure::Local(options) => local::run(options),
        Figure::Ros(options) => ros::run(options),
        Figure::Transport(options) => transport::run(options),
    }
}
