//! The `gdp-proxy` program: arguments, logging and signals. The library does the work.
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

use std::io::IsTerminal as _;
use std::net::SocketAddr;
use std::num::NonZeroU16;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Args, CommandFactory as _, Parser, Subcommand};
use gdp_core::cert::enrollment::MAX_LABEL;
use gdp_directory::of_server;
use gdp_proxy::config::schema;
use gdp_proxy::join::{Home, InvitationSource, Wishes};
use gdp_proxy::reload::{Loaded, Watch};
use gdp_proxy::stats::StatsFile;
use gdp_proxy::{dry_run, proxy};
use gdp_util::file_watch::FileWatcher;
use gdp_util::services::Services;
use gdp_util::{descriptors, log, panics, signals, terminal};

/// Carry the ROS topics, services and actions of a YAML configuration over the Global Data Plane.
///
/// The default configuration exposes nothing. The proxy reloads the file at SIGHUP and when it
/// changes. Unchanged entries continue without losing a message.
///
/// Exit status: 0 stopped by a signal or check passed, 1 failure, 2 wrong usage. The environment
/// variable RUST_LOG selects the log messages on stderr.
#[derive(Parser)]
#[command(version, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// Configuration file: the topics, services and actions to carry, and their keys
    #[arg(value_name = "FILE", required_unless_present_any = ["config", "schema"])]
    file: Option<PathBuf>,
    /// The same as FILE
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    config: Option<PathBuf>,
    /// Check the configuration and the files that it names, then exit
    #[arg(long)]
    check: bool,
    /// Observe the ROS graphs without the fabric, 3 seconds by default, then exit. Print what would
    /// cross under which name, and what would not and why
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "3", conflicts_with = "check")]
    dry_run: Option<NonZeroU16>,
    /// Print JSON (only with --dry-run)
    #[arg(short, long, requires = "dry_run")]
    json: bool,
    /// Print the JSON Schema of the configuration, then exit
    #[arg(long, exclusive = true)]
    schema: bool,
    /// File for counters, rewritten every second as one JSON object
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    /// Admin socket, which `gdp-ctl status` and `gdp-ctl top` ask, instead of the configured one
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
    /// Address and port of metrics in OpenMetrics, or a port alone for loopback, instead of the
    /// configured one
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = gdp_http::parse_address)]
    metrics: Option<SocketAddr>,
}

/// The package's unit for the proxy of this machine.
const UNIT: &str = "gdp-proxy.service";

#[derive(Subcommand)]
enum Command {
    /// Join a trust domain with an invitation of `gdp-ctl invite`, then run. The keys are made here
    ///
    /// Without LINE or --file, the invitation comes from the variable GDP_INVITATION, or from
    /// stdin. A LINE in the arguments is visible to other users of this machine.
    Join {
        /// The invitation
        #[arg(value_name = "LINE", conflicts_with = "file")]
        line: Option<String>,
        /// File with the invitation
        #[arg(long, value_name = "FILE")]
        file: Option<PathBuf>,
        #[command(flatten)]
        asks: Asks,
        /// Folder for keys and configuration [default: /etc/gdp for root, else ~/.config/gdp]
        #[arg(long, value_name = "FOLDER")]
        dir: Option<PathBuf>,
        /// Run here until ^C, also where the package has a service for it
        #[arg(long, conflicts_with = "no_run")]
        foreground: bool,
        /// If this machine has joined, use no invitation and run: for images that join at their
        /// first start
        #[arg(long)]
        unless_joined: bool,
        /// End after joining; start the proxy later with the printed configuration
        #[arg(long)]
        no_run: bool,
        /// File for counters, rewritten every second as one JSON object
        #[arg(long, value_name = "FILE")]
        stats: Option<PathBuf>,
    },
    /// Print the completions of commands and options for a shell
    Completion {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Write a manual page for each command into a folder
    #[command(hide = true)]
    Manual {
        /// The folder
        folder: PathBuf,
    },
    /// Leave the trust domain: end the membership of this machine and remove its files
    Leave {
        /// Leave even if the domain does not answer
        #[arg(long)]
        force: bool,
        /// Folder of keys and configuration [default: /etc/gdp for root, else ~/.config/gdp]
        #[arg(long, value_name = "FOLDER")]
        dir: Option<PathBuf>,
    },
}

/// What a machine asks for whose invitation is for applicants
#[derive(Args)]
#[command(next_help_heading = "With an invitation for applicants")]
struct Asks {
    /// Label to ask for [default: the host name]
    #[arg(long)]
    label: Option<String>,
    /// Topics that others may read, such as '/camera/**'
    #[arg(long, value_name = "PATTERN,…", value_delimiter = ',')]
    expose: Vec<String>,
    /// Topics to get from the server
    #[arg(long, value_name = "PATTERN,…", value_delimiter = ',')]
    import: Vec<String>,
    /// Topics of others to read, such as 'robot7:/camera/**'
    #[arg(long, value_name = "LABEL:PATTERN,…", value_delimiter = ',')]
    read: Vec<String>,
}

impl Asks {
    fn wishes(self) -> Result<Wishes> {
        let label = self.label.map_or_else(host_label, Ok)?;
        let read = self.read.iter().map(|text| text.parse().context("--read")).collect::<Result<_>>()?;
        Ok(Wishes { label, expose: self.expose, import: of_server(&self.import), read })
    }
}

/// Returns the host name as a label.
fn host_label() -> Result<String> {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").context("the host name; use --label")?;
    let label = host.trim().to_lowercase().replace(['-', '.'], "_");
    Ok(label.chars().take(MAX_LABEL).collect())
}

fn main() -> ExitCode {
    panics::end_process();
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return wrong_usage(&error),
    };
    let _log = log::start();
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let causes = terminal::join_causes(error.chain().map(ToString::to_string));
            terminal::note(format_args!("gdp-proxy: {causes}"));
            ExitCode::FAILURE
        }
    }
}

/// Prints help, version and errors as clap does. Errors quote the arguments, so they are escaped.
fn wrong_usage(error: &clap::Error) -> ExitCode {
    if error.use_stderr() {
        error.render().to_string().lines().for_each(terminal::note);
    } else if error.print().is_err() {
        return ExitCode::FAILURE;
    }
    ExitCode::from(if error.use_stderr() { 2 } else { 0 })
}

fn run(arguments: Arguments) -> Result<()> {
    let arguments = match arguments.command {
        Some(Command::Join { line, file, asks, dir, foreground, unless_joined, no_run, stats }) => {
            let home = Home::new(dir)?;
            if !(unless_joined && home.config().exists()) {
                join(&home, line, file, asks)?;
            }
            let services = services(&home).filter(|_| !foreground && !no_run && stats.is_none());
            if let Some(services) = services {
                services.start(&[UNIT])?;
                return Ok(terminal::print([format!("Running   as {UNIT}, now and at each boot")])?);
            }
            if no_run {
                return Ok(());
            }
            Arguments { command: None, config: Some(home.config()), stats, ..arguments }
        }
        Some(Command::Leave { force, dir }) => {
            return leave(&Home::new(dir)?, force);
        }
        Some(Command::Completion { shell }) => {
            let mut completions = Vec::new();
            clap_complete::generate(shell, &mut Arguments::command(), "gdp-proxy", &mut completions);
            return Ok(terminal::print(String::from_utf8_lossy(&completions).lines())?);
        }
        Some(Command::Manual { folder }) => return Ok(clap_mangen::generate_to(Arguments::command(), folder)?),
        None => arguments,
    };
    let Some(path) = arguments.file.clone().or(arguments.config.clone()) else {
        return Ok(terminal::print_json(&serde_json::to_string_pretty(&schema())?)?);
    };
    carry(&path, arguments)
}

/// Joins with the invitation, and prints what the machine now has.
fn join(home: &Home, line: Option<String>, file: Option<PathBuf>, asks: Asks) -> Result<()> {
    let source = match (line, file, std::env::var("GDP_INVITATION")) {
        (Some(line), ..) if line != "-" => {
            terminal::note("gdp-proxy: warning: other users of this machine can read the invitation in its arguments");
            InvitationSource::Line(line)
        }
        (_, Some(file), _) => InvitationSource::File(file),
        (None, None, Ok(line)) => InvitationSource::Line(line),
        _ => {
            if std::io::stdin().is_terminal() {
                terminal::note("Paste the invitation, then press Enter:");
            }
            InvitationSource::Stdin
        }
    };
    let joined = once()?.block_on(home.join(&source.read()?, asks.wishes()?, terminal::note))?;
    Ok(terminal::print(joined.lines)?)
}

/// Leaves the domain. The service stops before, because only one process may use the key.
fn leave(home: &Home, force: bool) -> Result<()> {
    let services = services(home);
    services.as_ref().map_or(Ok(()), |services| services.stop(&[UNIT]))?;
    match once()?.block_on(home.leave(force)) {
        Ok(lines) => Ok(terminal::print(lines)?),
        Err(error) => {
            if let Some(Err(failed)) = services.map(|services| services.start(&[UNIT])) {
                terminal::note(format_args!("gdp-proxy: {failed}"));
            }
            Err(error)
        }
    }
}

/// Returns the package's units, if they use this folder.
fn services(home: &Home) -> Option<Services> {
    Services::find(UNIT, home.folder(), "/etc/gdp")
}

/// Returns a runtime for one exchange with the domain.
fn once() -> Result<tokio::runtime::Runtime> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
    runtime.context("cannot start the runtime")
}

/// Runs the proxy with this configuration, or checks it.
fn carry(path: &Path, arguments: Arguments) -> Result<()> {
    if let Err(error) = descriptors::raise_limit() {
        tracing::warn!(%error, "the limit on open files stays as it was");
    }
    // The threads of DDS and of the node do half of the work.
    let workers = std::thread::available_parallelism().map_or(2, |cores| cores.get().div_ceil(2).max(2));
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(workers)
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let _entered = runtime.enter();
    let watcher = FileWatcher::start();
    // Created before the file is read, so that no change is missed.
    let watch = Watch::new(path, &watcher).context("cannot listen for SIGHUP")?;
    let loaded = || Loaded::load(path, &watcher);
    if arguments.check {
        let Loaded { config, material } = loaded()?;
        let good = format!(
            "{}: good, {} topics, {} services, {} actions, entity {}",
            path.display(),
            config.topics.len(),
            config.services.len(),
            config.actions.len(),
            material.identity.name()
        );
        return Ok(terminal::print([good])?);
    }
    runtime.block_on(async {
        if let Some(seconds) = arguments.dry_run {
            let report = dry_run::run(&loaded()?, Duration::from_secs(seconds.get().into())).await?;
            match arguments.json {
                true => terminal::print_json(&serde_json::to_string(&report)?)?,
                false => terminal::print(report.lines())?,
            }
            return Ok(());
        }
        let stop = signals::stop().context("cannot wait for SIGTERM and SIGINT")?;
        #[cfg(debug_assertions)]
        tokio::spawn(panics::inject());
        let mut loaded = loaded()?;
        loaded.config.socket = arguments.socket.or(loaded.config.socket);
        loaded.config.metrics = arguments.metrics.or(loaded.config.metrics);
        proxy::run(loaded, watch, arguments.stats.map(StatsFile::new), stop).await
    })
}

#[cfg(test)]
#[path = "../tests/unit/program.rs"]
mod tests;
