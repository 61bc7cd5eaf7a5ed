//! `cargo xtask bench NAME [--json]`: measures the figures in `docs/benchmarks`, one file for each.
//!
//! The compared alternatives are measured in one run under the same conditions, in turn, so that a
//! busy machine slows all of them.

mod calls;
mod control;
mod crypto;
mod forward;
mod hogs;
mod idle;
mod latency;
mod local;
pub mod paths;
mod program;
mod ros;
mod transport;
mod wire;

use anyhow::Result;

#[derive(clap::Args)]
pub struct Options {
    #[command(subcommand)]
    figure: Figure,
}

#[derive(clap::Subcommand)]
enum Figure {
    /// Measure the one-way latency from DDS to DDS over three XDP switches, compared with three IP
    /// routers
    Latency(latency::Options),
    /// Measure the cost of forwarding by XDP, compared with a bare redirect, kernel IPv4 routers
    /// and a forwarder on packet sockets
    Forward(forward::Options),
    /// Measure the control plane: statements and queries per second, memory per name, recovery
    /// after a cut, reconciliation
    Control(control::Options),
    /// Measure the cryptography of RustCrypto beside that of AWS-LC, by operation and by message
    Crypto(crypto::Options),
    /// Measure the paths between two endpoints on the switch's host: daemon, packet sockets,
    /// interface pair
    Local(local::Options),
    /// Measure latency and CPU time of ROS 2 messages through two proxies, compared with kernel
    /// routers and two zenoh bridges
    Ros(ros::Options),
    /// Measure ROS 2 messages while busy loops compete for the processors, compared with TCP
    Hogs(hogs::Options),
    /// Measure wake-ups and processor time of proxies and switches while nothing is published
    Idle(idle::Options),
    /// Measure the time of a service call that goes to one, two or three servers at once, while one
    /// of them is stalled for a part of each second
    Calls(calls::Options),
    /// Measure throughput, CPU time and latency of this SDK's messages, compared with quinn and TLS
    /// over TCP
    Transport(transport::Options),
    /// Measure messages over encrypted paths and several kinds of cables, compared with zenoh
    /// bridges, TLS over TCP, and QUIC
    Wire(wire::Options),
}

pub fn run(options: Options) -> Result<()> {
    match options.figure {
        Figure::Latency(options) => latency::run(options),
        Figure::Forward(options) => forward::run(options),
        Figure::Control(options) => control::run(options),
        Figure::Crypto(options) => crypto::run(options),
        Figure::Local(options) => local::run(options),
        Figure::Ros(options) => ros::run(options),
        Figure::Hogs(options) => hogs::run(options),
        Figure::Idle(options) => idle::run(options),
        Figure::Calls(options) => calls::run(options),
        Figure::Transport(options) => transport::run(options),
        Figure::Wire(options) => wire::run(options),
    }
}
