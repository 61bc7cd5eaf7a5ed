//! `gdp-ctl serve`: runs the daemon until it is told to stop.

use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use tokio::signal::unix::{SignalKind, signal};

use crate::cli::context::Context;
use gdp_daemon::config::{Config, DataPlane};
use gdp_daemon::serve;

#[derive(Debug, Args)]
pub struct Options {
    /// The configuration (YAML). Without one: a key of its own, RIB and switch on all interfaces and on UDP.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The switch's key file, instead of the configured one; made if there is none.
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Where to take links over UDP, instead of what is configured.
    #[arg(long, value_name = "ADDRESS:PORT")]
    udp: Option<SocketAddr>,
    /// What forwards frames, instead of what is configured.
    #[arg(long, value_name = "PLANE")]
    data_plane: Option<DataPlane>,
    /// The eBPF object, instead of the configured or installed one.
    #[arg(long, value_name = "FILE")]
    ebpf_object: Option<PathBuf>,
    /// When told to stop, end without a word and leave the kernel forwarding, for a successor to take over: for upgrades.
    #[arg(long)]
    keep: bool,
}

pub fn run(options: Options, context: &Context) -> anyhow::Result<()> {
    let _log = gdp_util::log::start();
    let mut config = match &options.config {
        Some(path) => Config::load(path)?,
        None => Config::embedded()?,
    };
    if let Some(socket) = &context.socket {
        config.socket = socket.clone();
    }
    config.identity = options.identity.unwrap_or(config.identity);
    config.udp = options.udp.or(config.udp);
    config.data_plane = options.data_plane.unwrap_or(config.data_plane);
    config.ebpf_object = options.ebpf_object.or(config.ebpf_object);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("cannot start the asynchronous runtime")?;
    runtime.block_on(async {
        let mut terminate = signal(SignalKind::terminate()).context("cannot wait for SIGTERM")?;
        let mut interrupt = signal(SignalKind::interrupt()).context("cannot wait for SIGINT")?;
        #[cfg(debug_assertions)]
        tokio::spawn(gdp_util::panics::inject());
        let running = serve::start(config).await?;
        tokio::select! {
            _ = terminate.recv() => tracing::info!("SIGTERM: shutting down"),
            _ = interrupt.recv() => tracing::info!("SIGINT: shutting down"),
        }
        if options.keep && running.outlives() {
            running.resign().await;
            tracing::info!("the kernel forwards on; start the next daemon soon, or run `gdp-ctl xdp detach`");
            gdp_util::log::flush();
            std::process::exit(0);
        }
        running.stop().await;
        Ok(())
    })
}
