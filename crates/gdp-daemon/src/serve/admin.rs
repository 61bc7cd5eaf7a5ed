//! The admin socket: a Unix socket for the user who runs the daemon. Each line is one JSON object,
//! in both directions; see [`gdp_proto::admin`]. Length and number of requests are bounded.

use std::os::unix::fs::{DirBuilderExt, FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_proto::admin::error::{ErrorCode, ErrorReply};
use gdp_proto::admin::links::LinksReply;
use gdp_proto::admin::trace::{
    Beyond, BeyondReply, DomainHop, DomainInside, EchoReply, InsideHop, LocateReply, PathEnd, ProbeReply,
};
use gdp_proto::admin::words::Outcome;
use gdp_proto::control::{Crossing, RefusalCode, Response, TracedDomain, TracedEnd, TracedSwitch};
use gdp_util::line_limit::LineLimit;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;

use super::core::probes::Location;
use super::daemon::Daemon;
use super::entity_requests::{self, Origin};
use super::events::Listener;
use super::status;
use super::trace::Hop;
use gdp_proto::admin::{MAX_REQUEST, PAGE, Reply, Request, reply_line};

/// The maximum number of connected clients.
const MAX_CLIENTS: usize = 32;

/// The maximum idle time of a client before its connection closes.
const IDLE: Duration = Duration::from_secs(30);

#[derive(Debug, thiserror::Error)]
pub enum AdminError {
    #[error("another daemon already answers at {}; stop it, or choose another socket", .0.display())]
    InUse(PathBuf),
    #[error("{} exists and is not a socket; remove it, or choose another socket", .0.display())]
    NotASocket(PathBuf),
    #[error("cannot open the admin socket {}: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
}

/// The socket file. Dropping this removes it.
pub struct Listening(PathBuf);

impl Drop for Listening {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_file(&self.0) {
            tracing::debug!(%error, "the admin socket was already gone");
        }
    }
}

/// Opens the socket for this process's user, and for its group if `is_for_group`. Replaces the file
/// of a crashed daemon.
pub fn listen(daemon: &Arc<Daemon>, path: &Path, is_for_group: bool) -> Result<Listening, AdminError> {
    let io = |source| AdminError::Io { path: path.into(), source };
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder).map_err(io)?;
    }
    match std::fs::symlink_metadata(path) {
        Ok(found) if !found.file_type().is_socket() => return Err(AdminError::NotASocket(path.into())),
        Ok(_) if std::os::unix::net::UnixStream::connect(path).is_ok() => return Err(AdminError::InUse(path.into())),
        Ok(_) => std::fs::remove_file(path).map_err(io)?,
        Err(_) => {}
    }
    let mode = if is_for_group { 0o660 } else { 0o600 };
    // Set the mode before the socket has its public path.
    let fresh = path.with_extension(format!("{}.new", std::process::id()));
    let _ = std::fs::remove_file(&fresh);
    let listener = UnixListener::bind(&fresh).map_err(io)?;
    std::fs::set_permissions(&fresh, std::fs::Permissions::from_mode(mode)).map_err(io)?;
    std::fs::rename(&fresh, path).map_err(io)?;
    daemon.spawn(accept(daemon.clone(), listener));
    Ok(Listening(path.into()))
}

async fn accept(daemon: Arc<Daemon>, listener: UnixListener) {
    let clients = Arc::new(Semaphore::new(MAX_CLIENTS));
    let warnings = LineLimit::new(1, Duration::from_secs(60));
    loop {
        let Ok(permit) = clients.clone().acquire_owned().await else { return };
        match listener.accept().await {
            Ok((stream, _)) => {
                let served = daemon.clone();
                daemon.spawn(async move {
                    if let Err(error) = serve(&served, stream).await {
                        tracing::debug!(%error, "an admin client went away");
                    }
                    drop(permit);
                });
            }
            Err(error) => {
                if let Some(suppressed) = warnings.take(Instant::now()) {
                    tracing::warn!(%error, suppressed, "cannot accept an admin client");
                }
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

async fn serve(daemon: &Arc<Daemon>, stream: UnixStream) -> std::io::Result<()> {
    let (reader, mut writer) = stream.into_split();
    let mut reader = BufReader::new(reader);
    let mut line = Vec::new();
    loop {
        line.clear();
        let mut bounded = (&mut reader).take(MAX_REQUEST as u64 + 1);
        let read = timeout(IDLE, bounded.read_until(b'\n', &mut line)).await;
        if !matches!(read, Ok(Ok(length)) if length > 0) {
            return Ok(());
        }
        let too_long = line.len() > MAX_REQUEST;
        let request = match too_long {
            true => Err(format!("a request longer than {MAX_REQUEST} bytes")),
            false => gdp_proto::admin::parse_request(&line),
        };
        let reply = match request {
            Ok(Request::Monitor) => {
                let listener = daemon.core().events.listen();
                writer.write_all(reply_line(&Reply::Monitoring).as_bytes()).await?;
                return monitor(listener, reader, writer).await;
            }
            Ok(request) => answer(daemon, request).await,
            Err(reason) => malformed(&reason),
        };
        timeout(IDLE, writer.write_all(reply_line(&reply).as_bytes())).await??;
        if too_long {
            return Ok(());
        }
    }
}

/// Writes one event per line until the client closes the connection or sends more. A client that
/// does not read delays only itself.
async fn monitor(
    mut events: Listener,
    mut reader: BufReader<OwnedReadHalf>,
    mut writer: OwnedWriteHalf,
) -> std::io::Result<()> {
    let tell = async {
        while let Some(event) = events.next().await {
            writer.write_all(reply_line(&Reply::Event(event)).as_bytes()).await?;
        }
        Ok(())
    };
    tokio::select! {
        result = tell => result,
        closed = reader.fill_buf() => closed.map(drop),
    }
}

async fn answer(daemon: &Arc<Daemon>, request: Request) -> Reply {
    match request {
        Request::Monitor => malformed("events have a connection of their own"),
        Request::Hello => status::hello(daemon).into(),
        Request::Status => Reply::Status(Box::new(status::status(daemon).await)),
        Request::Links => LinksReply { links: status::links(daemon, &daemon.core()) }.into(),
        Request::Peers => status::peers(&daemon.core()).into(),
        Request::Topology => status::topology(daemon).into(),
        Request::Fib { after } => or_failure(status::fib(daemon, after, PAGE)),
        Request::Rib { after } => or_failure(status::rib(daemon, after, PAGE)),
        Request::Locate { what } => {
            let core = daemon.core();
            or_failure(core.locate(&what).map(|Location { name, is_near, egress }| LocateReply {
                name,
                own: core.name(),
                near: is_near,
                egress,
                end: path_end(&core.switch.end_of(&name)),
            }))
        }
        Request::Echo { peer } => {
            or_failure(daemon.echo(peer).await.map(|time| EchoReply { rtt_us: time.map(micros) }))
        }
        Request::Probe { name, switch, hops } => {
            or_failure(daemon.probe(None, name, switch, hops).await.map(|hop| match hop {
                Some(Hop { switch, end, time }) => {
                    ProbeReply { switch: Some(switch), rtt_us: Some(micros(time)), end: end.as_ref().map(path_end) }
                }
                None => ProbeReply::default(),
            }))
        }
        Request::Beyond { name, border, domain, peer } => {
            let domains = daemon.trace_beyond(name, border, (domain, peer)).await;
            BeyondReply { domains: domains.into_iter().map(domain_hop).collect() }.into()
        }
        Request::Entity { entity, request } => {
            match entity_requests::answer(daemon, Origin::Tool(entity), *request).await {
                Response::Refused(refusal) => Reply::Error(refusal.into()),
                response => Reply::Control(response),
            }
        }
    }
}

fn path_end(end: &TracedEnd) -> PathEnd {
    let beyond = end.beyond.iter().map(|&(domain, switch)| Beyond { domain, switch });
    PathEnd { links: end.links, beyond: beyond.collect() }
}

fn domain_hop(TracedDomain { depth, domain, entry, rtt_us, crossing }: TracedDomain) -> DomainHop {
    let (outcome, reason, inside) = match crossing {
        Crossing::Traced { links, time_us, switches } => {
            let hop = |TracedSwitch { hop, switch, rtt_us }| InsideHop { hop, switch, rtt_us };
            let hops = switches.map(|switches| switches.into_iter().map(hop).collect());
            (Outcome::Traced, None, Some(DomainInside { links, rtt_us: time_us, hops }))
        }
        Crossing::Unanswered => (Outcome::Unanswered, None, None),
        Crossing::Refused { reason } => (Outcome::Refused, Some(reason), None),
        Crossing::Loop => (Outcome::Loop, None, None),
        Crossing::TooFar => (Outcome::TooFar, None, None),
    };
    DomainHop { depth, domain, switch: entry, rtt_us, outcome, reason, inside }
}

fn micros(time: Duration) -> u64 {
    time.as_micros() as u64
}

fn or_failure<R: Into<Reply>, E: ToString>(result: Result<R, E>) -> Reply {
    match result {
        Ok(reply) => reply.into(),
        Err(error) => Reply::Error(ErrorReply::new(ErrorCode::Failed, &error.to_string())),
    }
}

fn malformed(reason: &str) -> Reply {
    Reply::Error(ErrorReply::new(ErrorCode::Refused(RefusalCode::Malformed), reason))
}
