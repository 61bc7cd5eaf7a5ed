//! The command line, with one file for each command. Commands that create files need no daemon. The
//! others use the admin socket. Data goes to stdout (JSON with `-j`, each object with `"v": 2`),
//! everything else to stderr.

mod action;
mod advertise;
mod cert;
mod context;
pub(crate) mod credential_file;
mod doctor;
mod domain;
mod dump;
mod entity;
mod grant;
mod issuance_log;
mod issuing;
mod key;
mod link;
mod monitor;
mod name;
mod name_location;
mod node;
mod output;
mod peer;
mod ping;
mod progress;
mod query;
mod revocation;
mod schema;
mod serve;
mod service;
mod status;
mod topic;
mod topology;
mod trace;
mod xdp;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
use gdp_proto::admin::error::{ErrorCode, ErrorReply};
use gdp_util::escape::Escaped;
use gdp_util::terminal::{self, note};

use crate::client::ClientError;
use context::Context;
use gdp_dataplane::object;
use output::{FailureOutput, Output};

const VERSION: &str = if object::is_embedded() {
    concat!(env!("CARGO_PKG_VERSION"), " (with XDP)")
} else {
    concat!(env!("CARGO_PKG_VERSION"), " (built without XDP)")
};

/// Manage the names, certificates and daemon of the Global Data Plane.
#[derive(Debug, Parser)]
#[command(
    name = "gdp-ctl",
    version = VERSION,
    arg_required_else_help = true,
    after_help = "Exit status: 0 done, 1 failed or refused, 2 wrong usage, 3 no daemon answers."
)]
pub struct Cli {
    /// Path of the daemon's admin socket.
    #[arg(long, global = true, env = "GDP_SOCKET", value_name = "PATH")]
    socket: Option<PathBuf>,
    /// Print JSON: an object with the version `v`, or one object per line. A failure prints
    /// `{"v":2,"error":…}`.
    #[arg(short, long, global = true)]
    json: bool,
    /// Print the JSON Schema of each command's output with `-j`, then exit.
    #[arg(long)]
    schema: bool,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the daemon: the switch, and the RIB unless the configuration names a remote RIB.
    Serve(serve::Options),
    /// Advertise a name that an entity publishes, through the daemon's switch.
    Advertise(advertise::Options),
    /// Withdraw an entity's advertisement of a name, or its subscription to a name.
    Withdraw(advertise::WithdrawOptions),
    /// Show the publishers, readers, servers and callers of names, and verify every certificate
    /// locally.
    Query(query::Options),
    /// Show the daemon's links, data plane and counters.
    Status,
    /// Create and show name cards.
    #[command(subcommand)]
    Name(name::Command),
    /// Generate and show keys.
    #[command(subcommand)]
    Key(key::Command),
    /// Add, list and revoke grants to publish or read a name.
    #[command(subcommand)]
    Grant(grant::Command),
    /// Create a trust domain, manage its members and peerings, and revoke them.
    #[command(subcommand)]
    Domain(domain::Command),
    /// Show and verify certificates.
    #[command(subcommand)]
    Cert(cert::Command),
    /// Show the routes of the switch.
    #[command(subcommand)]
    Fib(dump::FibCommand),
    /// Show the records of the RIB.
    #[command(subcommand)]
    Rib(dump::RibCommand),
    /// Show the daemon's links.
    #[command(subcommand)]
    Link(link::Command),
    /// Show the neighbouring switches and domains of the daemon.
    #[command(subcommand)]
    Peer(peer::Command),
    Trace(trace::Options),
    Ping(ping::Options),
    /// Print events at the daemon's switch until ^C: links, attachments, refusals, routes, topology
    /// and RIB.
    Monitor,
    /// Show the domain's switches and the links between them, as known to the daemon's switch.
    Topology(topology::Options),
    /// List, measure, read and publish topics of the fabric; the counterpart of `ros2 topic`.
    #[command(subcommand)]
    Topic(topic::Command),
    /// List and call services of the fabric; the counterpart of `ros2 service`.
    #[command(subcommand)]
    Service(service::Command),
    /// List actions of the fabric; the counterpart of `ros2 action`.
    #[command(subcommand)]
    Action(action::Command),
    /// Check that this machine meets the daemon's requirements, and suggest a remedy for each
    /// problem.
    Doctor(doctor::Options),
    /// Show or remove the data plane in the kernel, with or without a running daemon.
    #[command(subcommand)]
    Xdp(xdp::Command),
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    gdp_util::panics::end_process();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // If arguments contain control characters, print the message that quotes them in
            // escaped form.
            let escaped = std::env::args_os().map(|argument| Escaped(argument.to_string_lossy()).to_string());
            return wrong_usage(&Cli::try_parse_from(escaped).err().unwrap_or(error));
        }
    };
    let context = Context { socket: cli.socket, output: Output { json: cli.json } };
    let done = match cli.command {
        _ if cli.schema => print_schema(),
        Some(command) => run(command, &context),
        None => return wrong_usage(&Cli::command().error(ErrorKind::MissingSubcommand, "a command is required")),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note(format_args!("gdp-ctl: {}", terminal::join_causes(error.chain().map(ToString::to_string))));
            // If stdout cannot be written, the line on stderr must suffice.
            let _ = context.output.print_failure(&error);
            let no_daemon = matches!(error.downcast_ref(), Some(ClientError::NoDaemon { .. }));
            ExitCode::from(if no_daemon { 3 } else { 1 })
        }
    }
}

fn print_schema() -> anyhow::Result<()> {
    Ok(terminal::print_json(&serde_json::to_string_pretty(&schema::schema())?)?)
}

/// Prints help and version as clap does. Prints errors with quoted arguments escaped.
fn wrong_usage(error: &clap::Error) -> ExitCode {
    if error.use_stderr() {
        let text = error.render().to_string();
        text.lines().for_each(note);
        let output = Output { json: std::env::args_os().any(|argument| argument == "-j" || argument == "--json") };
        let reason = text.split("\n\n").next().unwrap_or_default().trim_start_matches("error: ").to_owned();
        let remedy = Some("see the usage: add --help".to_owned());
        let failure = ErrorReply { code: ErrorCode::Usage, reason, remedy };
        if output.json && output.print(&FailureOutput { error: failure }, || None).is_err() {
            return ExitCode::FAILURE;
        }
    } else if error.print().is_err() {
        return ExitCode::FAILURE;
    }
    ExitCode::from(if error.use_stderr() { 2 } else { 0 })
}

fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Serve(options) => serve::run(options, context),
        Command::Advertise(options) => advertise::advertise(&options, context),
        Command::Withdraw(options) => advertise::withdraw(&options, context),
        Command::Query(options) => query::run(&options, context),
        Command::Status => status::run(context),
        Command::Name(command) => name::run(command, context),
        Command::Key(command) => key::run(command, context),
        Command::Grant(command) => grant::run(command, context),
        Command::Domain(command) => domain::run(command, context),
        Command::Cert(command) => cert::run(command, context),
        Command::Fib(command) => dump::fib(&command, context),
        Command::Rib(command) => dump::rib(&command, context),
        Command::Link(command) => link::run(&command, context),
        Command::Peer(command) => peer::run(&command, context),
        Command::Trace(options) => trace::run(&options, context),
        Command::Ping(options) => ping::run(&options, context),
        Command::Monitor => monitor::run(context),
        Command::Topology(options) => topology::run(&options, context),
        Command::Topic(command) => topic::run(command, context),
        Command::Service(command) => service::run(command, context),
        Command::Action(command) => action::run(command, context),
        Command::Doctor(options) => doctor::run(options, context),
        Command::Xdp(command) => xdp::run(&command, context),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cli.rs"]
mod tests;
