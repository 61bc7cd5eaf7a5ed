//! `gdp-ctl serve`: runs the daemon until it receives a signal to stop.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use clap::Args;
use tokio::signal::unix::{SignalKind, signal};

use crate::cli::context::Context;
use gdp_daemon::config::{Config, DataPlane};
use gdp_daemon::{privileges, serve};
use gdp_util::service_manager::ServiceManager;

#[derive(Debug, Args)]
pub struct Options {
    /// Configuration file (YAML). Without it, the daemon uses its own key, and runs a RIB and a
    /// switch with links over UDP.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Key file of the switch, instead of the configured one; generated if it does not exist.
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Address and port for links over UDP, instead of the configured ones.
    #[arg(long, value_name = "ADDRESS:PORT")]
    udp: Option<SocketAddr>,
    /// Interface for links directly on Ethernet, in addition to the configured ones; may be
    /// repeated. XDP attaches to it even if that disturbs its other users.
    #[arg(long, value_name = "DEV")]
    interface: Vec<String>,
    /// All Ethernet interfaces that are up, as if each were an --interface.
    #[arg(long, conflicts_with = "interface")]
    all_interfaces: bool,
    /// Data plane that forwards frames, instead of the configured one.
    #[arg(long, value_name = "PLANE")]
    data_plane: Option<DataPlane>,
    /// Forward only in the userspace plane; the same as `--data-plane userspace`.
    #[arg(long, conflicts_with_all = ["data_plane", "ebpf_object"])]
    no_xdp: bool,
    /// eBPF object file, instead of the configured or installed one.
    #[arg(long, value_name = "FILE")]
    ebpf_object: Option<PathBuf>,
    /// Address and port of metrics in OpenMetrics, or a port alone for loopback, instead of the
    /// configured one.
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = gdp_http::parse_address)]
    metrics: Option<SocketAddr>,
    /// On a stop signal, exit without notifying the neighbours and leave the kernel forwarding, so
    /// that a new daemon can take over during an upgrade.
    #[arg(long)]
    keep: bool,
}

/// Returns this process's command line, quoted for a shell.
fn command() -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,@%+".contains(c);
    let word = |word: String| match !word.is_empty() && word.chars().all(is_plain) {
        true => word,
        false => format!("'{}'", word.replace('\'', "'\\''")),
    };
    std::env::args_os().map(|argument| word(argument.to_string_lossy().into_owned())).collect::<Vec<_>>().join(" ")
}

pub fn run(options: Options, context: &Context) -> anyhow::Result<()> {
    let mut config = match &options.config {
        Some(path) => Config::load(path)?,
        None => Config::embedded()?,
    };
    if let Some(socket) = &context.socket {
        config.socket = socket.clone();
    }
    config.identity = options.identity.unwrap_or(config.identity);
    config.udp = options.udp.or(config.udp);
    config.metrics = options.metrics.or(config.metrics);
    config.data_plane = options.data_plane.unwrap_or(config.data_plane);
    if options.no_xdp {
        config.data_plane = DataPlane::Userspace;
    }
    config.ebpf_object = options.ebpf_object.or(config.ebpf_object);
    config.all_interfaces = options.all_interfaces;
    config.keep = options.keep;
    if !options.interface.is_empty() {
        config.name_interfaces(options.interface);
    }
    if let Some(backend) = config.crypto {
        backend.select()?;
    }
    // Drop privileges before other threads start.
    privileges::restrict(&config)?;
    let _log = gdp_util::log::start();
    if let Err(error) = gdp_util::descriptors::raise_limit() {
        tracing::warn!(%error, "the limit on open files stays as it was");
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("cannot start the asynchronous runtime")?;
    runtime.block_on(async {
        let mut terminate = signal(SignalKind::terminate()).context("cannot wait for SIGTERM")?;
        let mut interrupt = signal(SignalKind::interrupt()).context("cannot wait for SIGINT")?;
        #[cfg(debug_assertions)]
        tokio::spawn(gdp_util::panics::inject());
        let mut manager = ServiceManager::from_environment();
        manager.status("starting");
        let running = serve::start(config).await?;
        let ready = running.ready().line(&command());
        tracing::info!("{ready}");
        manager.ready(&ready);
        loop {
            tokio::select! {
                _ = terminate.recv() => break tracing::info!("SIGTERM: shutting down"),
                _ = interrupt.recv() => break tracing::info!("SIGINT: shutting down"),
                () = running.worked() => manager.alive(Instant::now()),
            }
        }
        manager.stopping();
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
