//! The admin socket of a program: a Unix socket whose clients send requests of one line each, and
//! get lines in return. Length, number and time of everything are bounded.
//!
//! Commands that end and clients that watch have slots of their own, so that watchers never keep
//! commands out. A client without a slot is told so.

use std::fs::{File, TryLockError};
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures_util::{Stream, StreamExt};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use crate::line_limit::LineLimit;

/// The maximum number of clients that send commands.
pub const MAX_COMMANDS: usize = 32;

/// The maximum number of clients that watch.
pub const MAX_WATCHERS: usize = 64;

/// The maximum number of clients that are being told that there is no slot.
const MAX_REFUSED: usize = 16;

/// The maximum idle time of a client before its connection closes.
const IDLE: Duration = Duration::from_secs(30);

/// Time for a client to read why it has no slot.
const REFUSAL: Duration = Duration::from_secs(1);

/// Time to wait for another program that opens its socket in the same folder.
const TURN: Duration = Duration::from_secs(5);

/// Reasons why the socket does not open.
#[derive(Debug, thiserror::Error)]
pub enum SocketError {
    #[error("another program already answers at {}; stop it, or choose another socket", .0.display())]
    InUse(PathBuf),
    #[error("{} exists and is not a socket; remove it, or choose another socket", .0.display())]
    NotASocket(PathBuf),
    #[error("other programs keep the folder {} locked; end them, or choose another socket", .0.display())]
    Locked(PathBuf),
    #[error("cannot open the admin socket {}: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
}

/// The socket file. Dropping this removes it.
#[derive(Debug)]
pub struct Listening(PathBuf);

impl Drop for Listening {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_file(&self.0) {
            tracing::debug!(%error, "the admin socket was already gone");
        }
    }
}

/// What answers a line.
pub enum Answer {
    Line(String),
    /// Lines until the client closes the connection or sends more, if a slot is free.
    Watch {
        first: String,
        lines: Pin<Box<dyn Stream<Item = String> + Send>>,
    },
}

/// Why a line got no answer from the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unanswered {
    #[error("a request longer than {0} bytes")]
    TooLong(usize),
    #[error("{MAX_COMMANDS} commands are connected, as many as have room; try again")]
    NoSlot,
    #[error("{MAX_WATCHERS} clients watch, as many as have room; end one of them")]
    NoWatcherSlot,
}

/// Answers lines. Errors are for the client, in the form of the program's protocol.
pub trait Answering: Send + Sync + 'static {
    /// The longest line in bytes.
    const MAX_LINE: usize;

    fn answer(&self, line: Vec<u8>) -> impl Future<Output = Answer> + Send;

    /// Returns the line for a client whose line is not answered.
    fn refuse(&self, why: Unanswered) -> String;
}

/// Opens the socket for its user and group. Replaces the file of a crashed program.
///
/// # Errors
///
/// Fails if another program answers there, if another file has the path, and if the system refuses.
pub fn listen(path: &Path) -> Result<(Listening, UnixListener), SocketError> {
    let io = |source| SocketError::Io { path: path.into(), source };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder).map_err(io)?;
    // Of two programs that start at the same time, the later one finds the socket of the earlier.
    let _turn = take_turn(folder, TURN).map_err(io)?.ok_or_else(|| SocketError::Locked(folder.into()))?;
    match std::fs::symlink_metadata(path) {
        Ok(found) if !found.file_type().is_socket() => return Err(SocketError::NotASocket(path.into())),
        Ok(_) if std::os::unix::net::UnixStream::connect(path).is_ok() => return Err(SocketError::InUse(path.into())),
        Ok(_) => std::fs::remove_file(path).map_err(io)?,
        Err(_) => {}
    }
    // Set the mode before the socket has its public path.
    let fresh = path.with_extension(format!("{}.new", std::process::id()));
    let _ = std::fs::remove_file(&fresh);
    let listener = UnixListener::bind(&fresh).map_err(io)?;
    std::fs::set_permissions(&fresh, std::fs::Permissions::from_mode(0o660)).map_err(io)?;
    std::fs::rename(&fresh, path).map_err(io)?;
    Ok((Listening(path.into()), listener))
}

/// Locks a folder until the file is dropped. Returns none if others keep it locked for that long.
fn take_turn(folder: &Path, longest: Duration) -> std::io::Result<Option<File>> {
    let file = File::open(folder)?;
    let until = Instant::now() + longest;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(Some(file)),
            Err(TryLockError::Error(error)) => return Err(error),
            Err(TryLockError::WouldBlock) if Instant::now() > until => return Ok(None),
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}

/// Serves clients until it is dropped.
pub async fn serve(listener: UnixListener, answering: impl Answering) {
    let answering = Arc::new(answering);
    let (commands, watchers, refused) = (slots(MAX_COMMANDS), slots(MAX_WATCHERS), slots(MAX_REFUSED));
    let warnings = LineLimit::new(1, Duration::from_secs(60));
    let mut clients = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            Some(_) = clients.join_next() => continue,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, _)) => match (commands.clone().try_acquire_owned(), refused.clone().try_acquire_owned()) {
                (Ok(slot), _) => {
                    let client = client(stream, slot, watchers.clone(), answering.clone());
                    clients.spawn(async move {
                        if let Err(error) = client.await {
                            tracing::debug!(%error, "an admin client went away");
                        }
                    });
                }
                (Err(_), Ok(slot)) => {
                    let line = answering.refuse(Unanswered::NoSlot);
                    clients.spawn(async move {
                        _ = timeout(REFUSAL, turn_away(stream, line)).await;
                        drop(slot);
                    });
                }
                (Err(_), Err(_)) => {}
            },
            Err(error) => {
                if let Some(suppressed) = warnings.take(Instant::now()) {
                    tracing::warn!(%error, suppressed, "cannot accept an admin client");
                }
                sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

fn slots(count: usize) -> Arc<Semaphore> {
    Arc::new(Semaphore::new(count))
}

/// Tells a client why it is not served, and waits until it has sent its request. A connection that
/// closes with unread data may lose the line.
async fn turn_away(stream: UnixStream, line: String) -> std::io::Result<()> {
    let (mut reader, mut writer) = stream.into_split();
    writer.write_all(line.as_bytes()).await?;
    writer.shutdown().await?;
    tokio::io::copy(&mut (&mut reader).take(1 << 20), &mut tokio::io::sink()).await.map(drop)
}

async fn client<A: Answering>(
    stream: UnixStream,
    slot: OwnedSemaphorePermit,
    watchers: Arc<Semaphore>,
    answering: Arc<A>,
) -> std::io::Result<()> {
    let (reader, mut writer) = stream.into_split();
    let mut reader = BufReader::new(reader);
    loop {
        let mut line = Vec::new();
        let mut bounded = (&mut reader).take(A::MAX_LINE as u64 + 1);
        let read = timeout(IDLE, bounded.read_until(b'\n', &mut line)).await;
        if !matches!(read, Ok(Ok(length)) if length > 0) {
            return Ok(());
        }
        let is_too_long = line.len() > A::MAX_LINE;
        let answer = match is_too_long {
            true => Answer::Line(answering.refuse(Unanswered::TooLong(A::MAX_LINE))),
            false => answering.answer(line).await,
        };
        let (line, lines) = match answer {
            Answer::Line(line) => (line, None),
            Answer::Watch { first, lines } => match watchers.clone().try_acquire_owned() {
                Ok(watcher) => (first, Some((watcher, lines))),
                Err(_) => (answering.refuse(Unanswered::NoWatcherSlot), None),
            },
        };
        timeout(IDLE, writer.write_all(line.as_bytes())).await??;
        if let Some((watcher, lines)) = lines {
            drop(slot);
            let watched = watch(lines, reader, writer).await;
            drop(watcher);
            return watched;
        }
        if is_too_long {
            return Ok(());
        }
    }
}

/// Writes lines until the client closes the connection or sends more. A client that does not read
/// delays only itself.
async fn watch(
    mut lines: Pin<Box<dyn Stream<Item = String> + Send>>,
    mut reader: BufReader<OwnedReadHalf>,
    mut writer: OwnedWriteHalf,
) -> std::io::Result<()> {
    let tell = async {
        while let Some(line) = lines.next().await {
            writer.write_all(line.as_bytes()).await?;
        }
        Ok(())
    };
    tokio::select! {
        result = tell => result,
        closed = reader.fill_buf() => closed.map(drop),
    }
}

#[cfg(test)]
#[path = "../tests/unit/line_socket.rs"]
mod tests;
