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
mod help;
mod home;
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
mod proxy_status;
mod query;
mod revocation;
mod schema;
mod serve;
mod service;
mod status;
mod top;
mod topic;
mod topology;
mod trace;
mod web;
mod xdp;

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
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
    /// Start a domain on this machine: switch, RIB, join service and proxy.
    #[command(after_help = "Creates what is missing, and runs until ^C. Run it again to go on with the same domain.")]
    Up(home::UpOptions),
    /// Print a line with which a robot, server or laptop joins the domain (`gdp-proxy join`).
    Invite(home::InviteOptions),
    /// Approve a machine that asks to join.
    Approve(home::ApproveOptions),
    /// Deny a machine that asks to join.
    Deny(home::DenyOptions),
    /// List the members of the domain, and machines that ask to become one.
    Robots(home::RobotsOptions),
    /// Revoke a member of the domain by its label.
    Revoke(home::RevokeOptions),
    /// Make the members of the domain those of a file.
    Apply(home::ApplyOptions),
    /// Back up and restore the domain, and show what was issued and revoked.
    #[command(subcommand)]
    Admin(home::AdminCommand),
    /// Run the domain's join service alone; `gdp-ctl up` starts it.
    JoinService(home::JoinServiceOptions),
    /// Run a switch, to which robots, servers and other switches connect.
    ///
    /// The daemon is also the RIB, unless its configuration names a remote one.
    Serve(serve::Options),
    /// Announce a name that an entity publishes, through this machine's switch.
    Advertise(advertise::Options),
    /// End an entity's announcement of a name, or its subscription to it.
    Withdraw(advertise::WithdrawOptions),
    /// Show who publishes, reads, serves or calls a name.
    ///
    /// The command verifies every certificate itself.
    Query(query::Options),
    /// Show the links, the data plane and the counters of a switch.
    Status(status::Options),
    /// Watch robots, topics, links and drops of this machine, as they change.
    Top(top::Options),
    /// Create and show name cards: the global names of topics, services and actions.
    #[command(subcommand)]
    Name(name::Command),
    /// Create and show private keys, one for each robot, server, switch or owner.
    #[command(subcommand)]
    Key(key::Command),
    /// Allow a robot or server to publish or read a name, and take that back.
    #[command(subcommand)]
    Grant(grant::Command),
    /// Create a trust domain, and admit, list and revoke its members.
    #[command(subcommand)]
    Domain(domain::Command),
    /// Show and verify a certificate file.
    #[command(subcommand)]
    Cert(cert::Command),
    /// Show where the switch forwards each name.
    #[command(subcommand)]
    Fib(dump::FibCommand),
    /// Show all publishers, readers and switches that the domain's RIB knows.
    #[command(subcommand)]
    Rib(dump::RibCommand),
    /// Show the links of this machine's switch.
    #[command(subcommand)]
    Link(link::Command),
    /// Show the neighbouring switches and domains.
    #[command(subcommand)]
    Peer(peer::Command),
    Trace(trace::Options),
    Ping(ping::Options),
    /// Print events of this machine's switch until ^C, such as links, refusals and routes.
    Monitor,
    Web(web::Options),
    /// Show the domain's switches, and the links between them.
    Topology(topology::Options),
    /// List, measure, read and publish topics, as `ros2 topic` does.
    #[command(subcommand)]
    Topic(topic::Command),
    /// List and call services, as `ros2 service` does.
    #[command(subcommand)]
    Service(service::Command),
    /// List actions, as `ros2 action` does.
    #[command(subcommand)]
    Action(action::Command),
    /// Check that this machine can run a switch, and suggest a remedy for each problem.
    Doctor(doctor::Options),
    /// Print the completions of commands and options for a shell.
    Completion {
        /// The shell.
        shell: clap_complete::Shell,
    },
    /// Write a manual page for each command into a folder.
    #[command(hide = true)]
    Manual {
        folder: PathBuf,
    },
    /// Show or remove the programs that forward in the kernel, also without a daemon.
    #[command(subcommand)]
    Xdp(xdp::Command),
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    gdp_util::panics::end_process();
    let cli = match parse(std::env::args_os()) {
        Ok(cli) => cli,
        Err(error) => {
            // If arguments contain control characters, print the message that quotes them in
            // escaped form.
            let escaped = std::env::args_os().map(|argument| Escaped(argument.to_string_lossy()).to_string());
            return wrong_usage(&parse(escaped).err().unwrap_or(error));
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

fn parse(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> Result<Cli, clap::Error> {
    let mut command = help::grouped(Cli::command());
    let mut matches = command.try_get_matches_from_mut(arguments)?;
    Cli::from_arg_matches_mut(&mut matches).map_err(|error| error.format(&mut command))
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
        Command::Up(options) => home::up(&options, context),
        Command::Invite(options) => home::invite(&options, context),
        Command::Approve(options) => home::approve(&options, context),
        Command::Deny(options) => home::deny(&options, context),
        Command::Robots(options) => home::robots(&options, context),
        Command::Revoke(options) => home::revoke(&options, context),
        Command::Apply(options) => home::apply(&options, context),
        Command::Admin(command) => home::admin(command, context),
        Command::JoinService(options) => home::join_service(&options),
        Command::Serve(options) => serve::run(options, context),
        Command::Advertise(options) => advertise::advertise(&options, context),
        Command::Withdraw(options) => advertise::withdraw(&options, context),
        Command::Query(options) => query::run(&options, context),
        Command::Status(options) => status::run(&options, context),
        Command::Top(options) => top::run(&options, context),
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
        Command::Web(options) => web::run(options, context),
        Command::Topology(options) => topology::run(&options, context),
        Command::Topic(command) => topic::run(command, context),
        Command::Service(command) => service::run(command, context),
        Command::Action(command) => action::run(command, context),
        Command::Completion { shell } => {
            let mut completions = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "gdp-ctl", &mut completions);
            Ok(terminal::print(String::from_utf8_lossy(&completions).lines())?)
        }
        Command::Manual { folder } => Ok(clap_mangen::generate_to(Cli::command(), folder)?),
        Command::Doctor(options) => doctor::run(options, context),
        Command::Xdp(command) => xdp::run(&command, context),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cli.rs"]
mod tests;
