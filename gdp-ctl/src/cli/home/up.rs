//! `gdp-ctl up`: a domain, a switch with its RIB, the join service and this machine's own proxy. It
//! asks nothing, makes what is missing, says what it made, and runs everything until ^C.

use std::io::Write as _;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::cert::TopicsOf;
use gdp_core::cert::enrollment::ALL_MEMBERS;
use gdp_util::terminal::{self, note};
use gdp_util::unix_time::unix_seconds;
use tokio::process::{Child, Command};
use tokio::signal::unix::{SignalKind, signal};

use super::create::{DomainOptions, Made};
use super::invite::Terms;
use super::{DAY, Home, HomeOptions, SERVER, join_service};
use crate::cli::context::Context;

/// Time within which the switch answers on its socket.
const START: Duration = Duration::from_secs(60);

/// Time for programs to end after a signal.
const END: Duration = Duration::from_secs(10);

#[derive(Debug, Args)]
pub struct Options {
    /// Host name or address, with a port if it differs, that members dial. Default: the address of
    /// this machine's default route.
    #[arg(long, value_name = "HOST")]
    at: Option<String>,
    /// Address and port for links over UDP.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "0.0.0.0:31415")]
    udp: SocketAddr,
    /// Attach no XDP program; forward in userspace.
    #[arg(long)]
    no_xdp: bool,
    /// Start no proxy here, so that members' topics are not in this machine's ROS graph.
    #[arg(long)]
    no_ros: bool,
    #[command(flatten)]
    home: HomeOptions,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let home = options.home.home()?;
    let at = options.at.clone().map_or_else(own_address, Ok)?;
    let socket = context.socket.as_deref();
    let made = home.create(&DomainOptions { at: &at, udp: options.udp, xdp: !options.no_xdp, socket })?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut terminate = signal(SignalKind::terminate()).context("cannot wait for SIGTERM")?;
        let mut interrupt = signal(SignalKind::interrupt()).context("cannot wait for SIGINT")?;
        let mut programs = Programs::default();
        let ended = tokio::select! {
            ended = programs.run(&home, options, &made, context) => ended,
            _ = terminate.recv() => Ok(()),
            _ = interrupt.recv() => Ok(()),
        };
        programs.stop().await;
        ended
    })
}

/// The programs that run.
#[derive(Default)]
struct Programs(Vec<(&'static str, Child)>);

impl Programs {
    /// Starts everything, and waits until a program ends, which is an error.
    async fn run(&mut self, home: &Home, options: &Options, made: &Made, context: &Context) -> anyhow::Result<()> {
        let own = std::env::current_exe().context("where this program is")?;
        let socket = context.socket.iter().flat_map(|socket| [Path::new("--socket"), socket]);
        self.start("switch", Command::new(&own).args(socket).args(["serve", "--config"]).arg(home.path("gdp.yaml")))?;
        tokio::select! {
            error = self.ended() => return Err(error),
            () = answers(context) => {}
            () = tokio::time::sleep(START) => bail!("the switch did not answer for {} s", START.as_secs()),
        }
        self.start("join service", Command::new(&own).arg("join-service").arg("--dir").arg(home.folder()))?;
        let proxy = if options.no_ros { None } else { self.start_proxy(home, &own).await? };
        tell(home, options, made, proxy.as_deref())?;
        Err(self.ended().await)
    }

    /// Starts this machine's own proxy, which joins first if it is new.
    async fn start_proxy(&mut self, home: &Home, own: &Path) -> anyhow::Result<Option<PathBuf>> {
        let proxy = own.with_file_name("gdp-proxy");
        if !proxy.exists() {
            note(format_args!("gdp-ctl: no gdp-proxy beside {}: members' topics are not in ROS here", own.display()));
            return Ok(None);
        }
        let folder = home.path(SERVER);
        let config = folder.join("proxy.yaml");
        if config.exists() {
            self.start("proxy", Command::new(&proxy).arg("--config").arg(&config))?;
            return Ok(Some(config));
        }
        let line = home.server_line()?;
        let mut command = Command::new(&proxy);
        command.args(["join", "--dir"]).arg(&folder).stdin(Stdio::piped()).stdout(Stdio::null());
        let child = self.start("proxy", &mut command)?;
        let stdin = child.stdin.take().context("the proxy's input")?.into_owned_fd()?;
        std::fs::File::from(stdin).write_all(line.as_bytes()).context("the proxy's input")?;
        Ok(Some(config))
    }

    fn start(&mut self, label: &'static str, command: &mut Command) -> anyhow::Result<&mut Child> {
        let child = command.kill_on_drop(true).spawn().with_context(|| format!("cannot start the {label}"))?;
        self.0.push((label, child));
        Ok(&mut self.0.last_mut().context("a program")?.1)
    }

    /// Waits until a program ends. Safe to cancel.
    async fn ended(&mut self) -> anyhow::Error {
        let waits = self.0.iter_mut().map(|(label, child)| Box::pin(async move { (*label, child.wait().await) }));
        let ((label, status), ..) = futures::future::select_all(waits).await;
        match status {
            Ok(status) => anyhow::anyhow!("the {label} ended: {status}"),
            Err(error) => anyhow::anyhow!("the {label} cannot be waited for: {error}"),
        }
    }

    /// Ends all programs, the last one first.
    async fn stop(self) {
        for (label, mut child) in self.0.into_iter().rev() {
            if let Some(pid) = child.id() {
                gdp_util::processes::terminate(pid);
            }
            if tokio::time::timeout(END, child.wait()).await.is_err() {
                note(format_args!("gdp-ctl: the {label} did not end within {} s and is killed", END.as_secs()));
            }
        }
    }
}

impl Home {
    /// Returns an invitation for this machine's own proxy, which reads what all members expose.
    fn server_line(&self) -> anyhow::Result<String> {
        let address = self.address()?;
        let read = vec![TopicsOf { member: ALL_MEMBERS.into(), topics: vec!["/**".into()] }];
        let (label, role) = (SERVER.to_owned(), SERVER.to_owned());
        let terms = Terms { label, role, expose: vec![], import: vec![], read, duration: 365 * DAY, within: 3600 };
        let at = format!("udp://127.0.0.1:{}", address.port).parse().context("this machine's own address")?;
        let (token, _) = self.invite(terms, at, &address)?;
        Ok(token.to_line().to_string() + "\n")
    }
}

/// Returns once the switch answers on its socket.
async fn answers(context: &Context) {
    while context.client().is_err() {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// Says what was made, what is open, and what comes next.
fn tell(home: &Home, options: &Options, made: &Made, proxy: Option<&Path>) -> anyhow::Result<()> {
    let (folder, address) = (home.folder().display(), home.address()?);
    let members = join_service::stored(home)?.rows(unix_seconds());
    let members = members.iter().filter(|row| row.enrollment.label != SERVER).count();
    let state = if made.is_new { "new" } else { "as it was" };
    let xdp = match options.no_xdp {
        true => "userspace plane",
        false => "XDP where it disturbs nothing; --no-xdp prevents it",
    };
    let ros = match proxy {
        Some(config) => format!("members' topics under /LABEL; {}", config.display()),
        None => "none".to_owned(),
    };
    terminal::print([
        format!(
            "Domain    {:#}, {state}, with {members} members; its key: {folder}/domain.pem (keep a copy)",
            made.domain
        ),
        format!("Switch    {:#} with the RIB; UDP {} is open ({xdp})", made.switch, options.udp),
        format!("Members   dial {}; another address: --at HOST", address.at),
        format!("ROS       {ros}"),
        "Next      gdp-ctl invite robot7 --expose '/chatter,/camera/**'".to_owned(),
    ])
    .context("cannot write to stdout")
}

/// Returns the address of the interface with the default route. No packet is sent.
fn own_address() -> anyhow::Result<String> {
    let address = || -> std::io::Result<IpAddr> {
        let socket = UdpSocket::bind("0.0.0.0:0")?;
        socket.connect("192.0.2.1:9")?;
        Ok(socket.local_addr()?.ip())
    };
    Ok(address().context("this machine has no default route; say what members dial with --at HOST")?.to_string())
}
