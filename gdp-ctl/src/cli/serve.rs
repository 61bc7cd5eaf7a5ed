//! `gdp-ctl serve`: runs the daemon until it receives a signal to stop.

use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use tokio::signal::unix::{SignalKind, signal};

use crate::cli::context::Context;
use gdp_daemon::config::{Config, DataPlane};
use gdp_daemon::{privileges, serve};

#[derive(Debug, Args)]
pub struct Options {
    /// The configuration (YAML). Without one: a key of its own, RIB and switch, with links over
    /// UDP.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The switch's key file, instead of the configured one; made if there is none.
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Where to take links over UDP, instead of what is configured.
    #[arg(long, value_name = "ADDRESS:PORT")]
    udp: Option<SocketAddr>,
    /// Also take links directly on the Ethernet of this interface, and attach XDP there whatever
    /// that disturbs; may be repeated.
    #[arg(long, value_name = "DEV")]
    interface: Vec<String>,
    /// Name every Ethernet interface that is up.
    #[arg(long, conflicts_with = "interface")]
    all_interfaces: bool,
    /// What forwards frames, instead of what is configured.
    #[arg(long, value_name = "PLANE")]
    data_plane: Option<DataPlane>,
    /// Forward by the userspace plane alone, as `--data-plane userspace` does.
    #[arg(long, conflicts_with_all = ["data_plane", "ebpf_object"])]
    no_xdp: bool,
    /// The eBPF object, instead of the configured or installed one.
    #[arg(long, value_name = "FILE")]
    ebpf_object: Option<PathBuf>,
    /// When told to stop, end without a word and leave the kernel forwarding, for a successor to
    /// take over: for upgrades.
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
    config.data_plane = options.data_plane.unwrap_or(config.data_plane);
    if options.no_xdp {
        config.data_plane = DataPlane::Userspace;
    }
    config.ebpf_object = options.ebpf_object.or(config.ebpf_object);
    config.all_interfaces = options.all_interfaces;
    if !options.interface.is_empty() {
        config.name_interfaces(options.interface);
    }
    // Drop privileges before other threads start.
    privileges::restrict(&config)?;
    let _log = gdp_util::log::start();
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
        tracing::info!("{}", running.ready().line(&command()));
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
