//! `gdp-ctl up`: a domain, a switch with its RIB, the join service and this machine's own proxy. It
//! asks nothing, makes what is missing, says what it made, and starts everything: as services where
//! the packages are installed, else here until ^C.

use std::env;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use gdp_core::cert::TopicsOf;
use gdp_core::cert::enrollment::ALL_MEMBERS;
use gdp_core::domain::Token;
use gdp_core::secret_file;
use gdp_util::services::Services;
use gdp_util::signals;
use gdp_util::terminal::{self, note};
use gdp_util::unix_time::unix_seconds;
use tokio::process::{Child, Command};

use super::create::{DomainOptions, Made};
use super::invite::Terms;
use super::renewals::RENEWABLE;
use super::{HOUR, Home, HomeOptions, members, revoke};
use crate::cli::context::Context;
use crate::cli::issuance_log::newest_revocation;
use crate::cli::issuing::parse_seconds;
use crate::cli::revocation;
use gdp_directory::SERVER;

/// Time within which the switch answers on its socket.
const START: Duration = Duration::from_secs(60);

/// Pause before a program that ended is started again.
const RESTART: Duration = Duration::from_secs(1);

/// The units of the packages, and the folder that they use.
const SWITCH_UNIT: &str = "gdp-switch.service";
const JOIN_UNIT: &str = "gdp-join.service";
const SERVER_UNIT: &str = "gdp-proxy@home-server.service";
const HOME_OF_UNITS: &str = "/etc/gdp/home";

const SWITCH: &str = "switch";
const JOIN_SERVICE: &str = "join service";
const PROXY: &str = "proxy";

/// Time for programs to end after a signal.
const END: Duration = Duration::from_secs(10);

#[derive(Debug, Args)]
pub struct Options {
    /// Host name or address, with a port if it differs, that members dial. Default: as before, else
    /// the address of this machine's default route.
    #[arg(long, value_name = "HOST")]
    at: Option<String>,
    /// Address and port for links over UDP. Default: as before, else 0.0.0.0:31415.
    #[arg(long, value_name = "ADDRESS:PORT")]
    udp: Option<SocketAddr>,
    /// Also take links over TLS, for members whose networks let no UDP out; without an address, at
    /// 0.0.0.0:443. Default: as before.
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "0.0.0.0:443")]
    tls: Option<SocketAddr>,
    /// Take no links over TLS, now and later.
    #[arg(long, conflicts_with = "tls")]
    no_tls: bool,
    /// Attach no XDP program, now and later; forward in userspace.
    #[arg(long)]
    no_xdp: bool,
    /// Time for which a membership lasts without a renewal. The join service renews it after half
    /// of it, while the member is connected. Default: as before, else 60d.
    #[arg(long, value_name = "TIME", value_parser = parse_seconds)]
    lifetime: Option<u32>,
    /// Start no proxy here, so that members' topics are not in this machine's ROS graph.
    #[arg(long)]
    no_ros: bool,
    /// Run everything here until ^C, also where the packages have services for it.
    #[arg(long)]
    foreground: bool,
    #[command(flatten)]
    home: HomeOptions,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let home = options.home.home()?;
    let socket = context.socket.as_deref();
    let Options { udp, tls, no_tls, no_xdp, lifetime, .. } = *options;
    let (at, lifetime) = (options.at.as_deref(), lifetime.map(u64::from));
    let made = home.create(&DomainOptions { at, udp, tls, no_tls, no_xdp, lifetime, socket })?;
    let services = Services::find(SWITCH_UNIT, home.folder(), HOME_OF_UNITS).filter(|_| !options.foreground);
    if let Some(services) = services {
        return start_services(&services, &home, options, &made, context);
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let stop = signals::stop().context("cannot wait for SIGTERM and SIGINT")?;
        let mut programs = Programs::default();
        let ended = tokio::select! {
            ended = programs.run(&home, options, &made, context) => ended,
            () = stop => Ok(()),
        };
        programs.stop().await;
        ended
    })
}

/// Starts everything as services, now and at each boot.
fn start_services(
    services: &Services,
    home: &Home,
    options: &Options,
    made: &Made,
    context: &Context,
) -> anyhow::Result<()> {
    services.start(&[SWITCH_UNIT])?;
    home.publish_revocation(context)?;
    services.start(&[JOIN_UNIT])?;
    let mut units = vec![SWITCH_UNIT, JOIN_UNIT];
    let launcher = Launcher { home, own: env::current_exe().context("where this program is")?, socket: None };
    if !options.no_ros && launcher.has_proxy() {
        if !home.server_config().exists() {
            let status = launcher.join(context)?.arg("--no-run").status().context("cannot start gdp-proxy")?;
            ensure!(status.success(), "this machine's proxy did not join: {status}");
        }
        services.start(&[SERVER_UNIT])?;
        units.push(SERVER_UNIT);
    }
    tell(home, made, units.contains(&SERVER_UNIT), Some(&units))
}

/// The programs that run, by their labels.
#[derive(Default)]
struct Programs(Vec<(&'static str, Child)>);

/// The folder of the domain, and this program.
struct Launcher<'a> {
    home: &'a Home,
    own: PathBuf,
    socket: Option<&'a Path>,
}

impl Programs {
    /// Starts everything, and runs it until the switch ends, which is an error. Other programs that
    /// end are started again.
    async fn run(&mut self, home: &Home, options: &Options, made: &Made, context: &Context) -> anyhow::Result<()> {
        if context.client().is_ok() {
            bail!("a daemon answers on the admin socket already: stop it, or choose another socket with --socket");
        }
        let own = env::current_exe().context("where this program is")?;
        let site = Launcher { home, own, socket: context.socket.as_deref() };
        self.start(SWITCH, site.switch())?;
        tokio::select! {
            (label, status) = self.ended() => bail!("the {label} ended: {status}"),
            () = answers(context) => {}
            () = tokio::time::sleep(START) => bail!("the switch did not answer for {} s", START.as_secs()),
        }
        home.publish_revocation(context)?;
        self.start(JOIN_SERVICE, site.join_service())?;
        let has_proxy = !options.no_ros && site.has_proxy();
        if has_proxy {
            self.start_proxy(&site, context)?;
        }
        tell(home, made, has_proxy, None)?;
        loop {
            let (label, status) = self.ended().await;
            if label == SWITCH {
                bail!("the {label} ended: {status}");
            }
            note(format_args!("gdp-ctl: the {label} ended: {status}; starting it again"));
            tokio::time::sleep(RESTART).await;
            match label {
                JOIN_SERVICE => self.start(label, site.join_service())?,
                _ => self.start_proxy(&site, context)?,
            }
        }
    }

    /// Starts this machine's own proxy, which joins first if it has not yet.
    fn start_proxy(&mut self, site: &Launcher, context: &Context) -> anyhow::Result<()> {
        let config = site.home.server_config();
        if config.exists() {
            let mut command = site.proxy();
            command.arg("--config").arg(&config);
            return self.start(PROXY, command);
        }
        self.start(PROXY, site.join(context)?.into())
    }

    fn start(&mut self, label: &'static str, mut command: Command) -> anyhow::Result<()> {
        let child = command.kill_on_drop(true).spawn().with_context(|| format!("cannot start the {label}"))?;
        self.0.push((label, child));
        Ok(())
    }

    /// Waits until a program ends, and forgets it. Safe to cancel.
    async fn ended(&mut self) -> (&'static str, String) {
        let waits = self.0.iter_mut().map(|(label, child)| Box::pin(async move { (*label, child.wait().await) }));
        let ((label, status), at, _) = futures::future::select_all(waits).await;
        self.0.remove(at);
        (label, status.map_or_else(|error| error.to_string(), |status| status.to_string()))
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

impl Launcher<'_> {
    fn switch(&self) -> Command {
        let mut command = gdp_util::processes::command(&self.own);
        if let Some(socket) = self.socket {
            command.arg("--socket").arg(socket);
        }
        command.args(["serve", "--config"]).arg(self.home.path("gdp.yaml"));
        command.into()
    }

    fn join_service(&self) -> Command {
        let mut command = gdp_util::processes::command(&self.own);
        command.arg("join-service").arg("--dir").arg(self.home.folder());
        command.into()
    }

    fn proxy(&self) -> Command {
        gdp_util::processes::command(&self.own.with_file_name("gdp-proxy")).into()
    }

    /// Returns the command with which this machine's own proxy joins, and then runs.
    fn join(&self, context: &Context) -> anyhow::Result<std::process::Command> {
        let mut command = gdp_util::processes::command(&self.own.with_file_name("gdp-proxy"));
        command.args(["join", "--dir"]).arg(self.home.path(SERVER)).arg("--file");
        command.arg(self.home.server_invitation(context)?).stdout(Stdio::null());
        Ok(command)
    }

    /// Returns whether gdp-proxy is beside this program; says so if it is not.
    fn has_proxy(&self) -> bool {
        let exists = self.own.with_file_name("gdp-proxy").exists();
        if !exists {
            let own = self.own.display();
            note(format_args!("gdp-ctl: no gdp-proxy beside {own}: members' topics are not in ROS here"));
        }
        exists
    }
}

impl Home {
    fn server_config(&self) -> PathBuf {
        self.path(SERVER).join("proxy.yaml")
    }

    /// Publishes the newest revocation, which may have been made while no daemon answered.
    fn publish_revocation(&self, context: &Context) -> anyhow::Result<()> {
        let card = self.card()?;
        match newest_revocation(&card, &self.revocation_path())? {
            Some((signed, _)) => revocation::send(&card, signed, context),
            None => Ok(()),
        }
    }

    /// Returns the file with an invitation for this machine's own proxy, which reads what all
    /// members expose. An attempt that was interrupted uses the same one again.
    fn server_invitation(&self, context: &Context) -> anyhow::Result<PathBuf> {
        let path = self.path("server.invitation");
        let known = std::fs::read_to_string(&path).ok().and_then(|line| Token::from_line(&line).ok());
        let holds = |token: &Token| token.invite().is_ok_and(|invite| invite.not_after > unix_seconds());
        if known.is_some_and(|token| holds(&token)) {
            return Ok(path);
        }
        if self.enrolled()?.contains_key(SERVER) {
            revoke::revoke(self, &[SERVER.to_owned()], context)?;
        }
        let address = self.address()?;
        let read = ["/**", "service:/**", "action:/**"].map(str::to_owned).to_vec();
        let read = vec![TopicsOf { member: ALL_MEMBERS.into(), topics: read }];
        let (label, role) = (SERVER.to_owned(), SERVER.to_owned());
        let (duration, within) = (RENEWABLE, HOUR);
        let terms = Terms { label, role, expose: vec![], import: vec![], read, duration, within };
        let (token, _) = self.invite(terms, address.local(), address.switch)?;
        secret_file::replace(&path, token.to_line().as_bytes())?;
        Ok(path)
    }
}

/// Returns once the switch answers on its socket.
async fn answers(context: &Context) {
    while context.client().is_err() {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// Says what was made, what is open, and what comes next.
fn tell(home: &Home, made: &Made, has_proxy: bool, units: Option<&[&str]>) -> anyhow::Result<()> {
    let (folder, address) = (home.folder().display(), home.address()?);
    let members = members::stored(home)?.rows(unix_seconds());
    let members = members.iter().filter(|row| row.enrollment.label != SERVER).count();
    let state = if made.is_new { "new" } else { "as it was" };
    let xdp = if address.xdp { "XDP where it disturbs nothing; --no-xdp prevents it" } else { "userspace plane" };
    let ros = match has_proxy {
        true => format!("members' topics under /LABEL; {}", home.server_config().display()),
        false => "none".to_owned(),
    };
    let tls = address.tls.map_or(String::new(), |tls| format!(", TCP {tls} for TLS"));
    let over_tls = address.tls_targets()?.first().map_or(String::new(), |target| format!(", else {target}"));
    let services = units.map(|units| format!("Services  {}: started, now and at each boot", units.join(", ")));
    let lines = [
        format!("Domain    {:#}, {state}, with {members} members", made.domain),
        format!("Keys      {folder}/domain.pem, and successor.pem if that is lost: move it elsewhere"),
        format!("Switch    {:#} with the RIB; UDP {} is open{tls} ({xdp})", made.switch, address.udp),
        format!("Members   dial {}{over_tls}; another address: --at HOST", address.at),
        format!("ROS       {ros}"),
    ];
    let next = "Next      gdp-ctl invite robot7 --expose '/chatter,/camera/**'".to_owned();
    terminal::print(lines.into_iter().chain(services).chain([next])).context("cannot write to stdout")
}
