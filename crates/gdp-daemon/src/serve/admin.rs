//! The admin socket: a Unix socket for the user who runs the daemon. One JSON object per line each
//! way, see [`gdp_proto::admin`]; bounded in length and number.

use std::os::unix::fs::{DirBuilderExt, FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use gdp_proto::control::{Crossing, Response, TracedDomain, TracedEnd, TracedSwitch};
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;

use super::core::probes::{Location, ProbeError};
use super::daemon::Daemon;
use super::entity_requests::{self, Origin};
use super::events::Listener;
use super::status;
use super::trace::Hop;
use gdp_proto::admin::{MAX_REQUEST, PAGE, Reply, Request, reply_line};

/// Commands served at once.
const MAX_CLIENTS: usize = 32;

/// A client that says nothing for this long is let go.
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

/// The socket file, removed at the end.
pub struct Listening(PathBuf);

impl Drop for Listening {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_file(&self.0) {
            tracing::debug!(%error, "the admin socket was already gone");
        }
    }
}

/// Opens the socket, mode 0600; a file left by a daemon that crashed is replaced.
pub fn listen(daemon: &Arc<Daemon>, path: &Path) -> Result<Listening, AdminError> {
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
    // The socket gets its mode before anybody knows its name.
    let fresh = path.with_extension(format!("{}.new", std::process::id()));
    let _ = std::fs::remove_file(&fresh);
    let listener = UnixListener::bind(&fresh).map_err(io)?;
    std::fs::set_permissions(&fresh, std::fs::Permissions::from_mode(0o600)).map_err(io)?;
    std::fs::rename(&fresh, path).map_err(io)?;
    daemon.spawn(accept(daemon.clone(), listener));
    Ok(Listening(path.into()))
}

async fn accept(daemon: Arc<Daemon>, listener: UnixListener) {
    let clients = Arc::new(Semaphore::new(MAX_CLIENTS));
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
                tracing::warn!(%error, "cannot accept an admin client");
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
                writer.write_all(reply_line(&Reply::Ok(json!({}))).as_bytes()).await?;
                return monitor(listener, reader, writer).await;
            }
            Ok(request) => answer(daemon, request).await,
            Err(reason) => Reply::Error { code: "malformed".into(), reason },
        };
        timeout(IDLE, writer.write_all(reply_line(&reply).as_bytes())).await??;
        if too_long {
            return Ok(());
        }
    }
}

/// Writes what happens, one event to a line, until the client closes the connection or says more. A
/// client that does not read holds up nobody but itself.
async fn monitor(
    mut events: Listener,
    mut reader: BufReader<OwnedReadHalf>,
    mut writer: OwnedWriteHalf,
) -> std::io::Result<()> {
    let tell = async {
        while let Some(event) = events.next().await {
            writer.write_all(reply_line(&Reply::Ok(event)).as_bytes()).await?;
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
        Request::Monitor => {
            Reply::Error { code: "malformed".into(), reason: "events have a connection of their own".into() }
        }
        Request::Peers => {
            let core = daemon.core();
            Reply::Ok(json!({"domain": core.membership.home(), "peers": status::peers(&core)}))
        }
        Request::Locate { what } => {
            let core = daemon.core();
            probed(core.locate(&what).map(|Location { name, is_near, egress }| {
                json!({
                    "name": name, "own": core.name(), "near": is_near, "egress": egress,
                    "end": ended(&core.switch.end_of(&name)),
                })
            }))
        }
        Request::Echo { peer } => probed(daemon.echo(peer).await.map(|time| json!({"rtt_us": time.map(micros)}))),
        Request::Probe { name, switch, hops } => {
            probed(daemon.probe(None, name, switch, hops).await.map(|hop| match hop {
                Some(Hop { switch, end, time }) => {
                    json!({"switch": switch, "rtt_us": micros(time), "end": end.as_ref().map(ended)})
                }
                None => json!({"switch": null, "rtt_us": null, "end": null}),
            }))
        }
        Request::Beyond { name, border, domain, peer } => {
            let domains = daemon.trace_beyond(name, border, (domain, peer)).await;
            Reply::Ok(json!({"domains": domains.iter().map(crossed).collect::<Vec<_>>()}))
        }
        Request::Status => Reply::Ok(status::status(daemon).await),
        Request::Links => Reply::Ok(json!({"links": status::links(&daemon.core())})),
        Request::Topology => Reply::Ok(status::topology(daemon)),
        Request::Fib { after } => page(status::fib(daemon, after, PAGE)),
        Request::Rib { after } => page(status::rib(daemon, after, PAGE)),
        Request::Entity { entity, request } => {
            match entity_requests::answer(daemon, Origin::Tool(entity), *request).await {
                Response::Refused(refusal) => {
                    let code = serde_json::to_value(refusal.code).ok();
                    let code = code.as_ref().and_then(Value::as_str).unwrap_or("Refused").to_owned();
                    Reply::Error { code, reason: refusal.reason }
                }
                response => Reply::Control(response),
            }
        }
    }
}

/// What a name is delivered to at its egress switch.
fn ended(end: &TracedEnd) -> Value {
    let beyond: Vec<_> =
        end.beyond.iter().map(|(domain, switch)| json!({"domain": domain, "switch": switch})).collect();
    json!({"links": end.links, "beyond": beyond})
}

/// A domain that a name crosses.
fn crossed(TracedDomain { depth, domain, entry, rtt_us, crossing }: &TracedDomain) -> Value {
    let (outcome, reason) = match crossing {
        Crossing::Traced { .. } => ("traced", None),
        Crossing::Unanswered => ("unanswered", None),
        Crossing::Refused { reason } => ("refused", Some(reason)),
        Crossing::Loop => ("loop", None),
        Crossing::TooFar => ("too_far", None),
    };
    let mut value = json!({
        "depth": depth, "domain": domain, "switch": entry, "rtt_us": rtt_us, "outcome": outcome, "reason": reason,
    });
    if let Crossing::Traced { links, time_us, switches } = crossing {
        let hop = |at: &TracedSwitch| json!({"hop": at.hop, "switch": at.switch, "rtt_us": at.rtt_us});
        let hops = switches.as_ref().map(|switches| switches.iter().map(hop).collect::<Vec<_>>());
        value["inside"] = json!({"links": links, "rtt_us": time_us, "hops": hops});
    }
    value
}

fn micros(time: Duration) -> u64 {
    time.as_micros() as u64
}

fn probed(result: Result<Value, ProbeError>) -> Reply {
    page(result.map_err(|error| error.to_string()))
}

fn page(result: Result<Value, String>) -> Reply {
    match result {
        Ok(value) => Reply::Ok(value),
        Err(reason) => Reply::Error { code: "failed".into(), reason },
    }
}
