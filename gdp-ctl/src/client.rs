//! Client of the daemon's admin socket.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use gdp_proto::admin::error::{ErrorCode, ErrorReply};
use gdp_proto::admin::event::TimedEvent;
use gdp_proto::admin::proxy::ProxyReply;
use gdp_proto::admin::status::StatusReply;
use gdp_proto::admin::{MAX_REPLY, Reply, Request, VERSION, Versioned, check_version};
use gdp_proto::control::RefusalCode;
use serde_json::Value;

/// Timeout for a daemon's reply.
const TIMEOUT: Duration = Duration::from_secs(15);

/// Reasons why a command got no usable reply.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    #[error(
        "no daemon answers at {}: {source}; start one with `gdp-ctl serve`, or say where it is with --socket. A \
         robot needs none: there, use `gdp-ctl topic`, `service`, `query`, `ping`, `trace` and `status` with \
         --switch udp://HOST", path.display()
    )]
    NoDaemon { path: PathBuf, source: std::io::Error },
    #[error(
        "not allowed to use the daemon's socket {}; run this as the user who runs the daemon, or as a member of the \
         socket's group",
        .0.display()
    )]
    NotAllowed(PathBuf),
    #[error("the daemon has not answered within {} s; `gdp-ctl doctor` looks at this machine", TIMEOUT.as_secs())]
    Silent,
    #[error("the daemon has closed the connection ({0}); look into its log, and repeat the command")]
    Broken(std::io::Error),
    #[error("the daemon gave an answer that this program does not understand: {0}")]
    Malformed(String),
    #[error("{}", .0.message())]
    Refused(ErrorReply),
}

/// Returns the error of a connection that has failed. A read that times out fails as if it blocked.
fn broken(error: std::io::Error) -> ClientError {
    match error.kind() {
        ErrorKind::WouldBlock | ErrorKind::TimedOut => ClientError::Silent,
        _ => ClientError::Broken(error),
    }
}

impl ClientError {
    pub fn code(&self) -> ErrorCode {
        match self {
            Self::NoDaemon { .. } => ErrorCode::NoDaemon,
            Self::NotAllowed(_) => ErrorCode::NotAllowed,
            Self::Silent | Self::Broken(_) => ErrorCode::Disconnected,
            Self::Malformed(_) => ErrorCode::Refused(RefusalCode::Malformed),
            Self::Refused(failure) => failure.code,
        }
    }
}

/// The state of the program that answers.
pub enum ProgramStatus {
    Switch(Box<StatusReply>),
    Proxy(Box<ProxyReply>),
}

/// A connection to the daemon.
pub struct Client {
    stream: BufReader<UnixStream>,
}

impl Client {
    pub fn connect(path: &Path) -> Result<Self, ClientError> {
        let stream = UnixStream::connect(path).map_err(|source| match source.kind() {
            ErrorKind::PermissionDenied => ClientError::NotAllowed(path.into()),
            _ => ClientError::NoDaemon { path: path.into(), source },
        })?;
        stream.set_read_timeout(Some(TIMEOUT)).map_err(broken)?;
        stream.set_write_timeout(Some(TIMEOUT)).map_err(broken)?;
        Ok(Self { stream: BufReader::new(stream) })
    }

    /// Sends a request and returns a reply of the expected type. A refusal is an error.
    pub fn ask<T: TryFrom<Reply>>(&mut self, request: &Request) -> Result<T, ClientError> {
        let reply = self.exchange(request)?;
        T::try_from(reply).map_err(|_| ClientError::Malformed("another kind of reply".into()))
    }

    /// Asks a switch or a proxy for its state.
    pub fn status(&mut self) -> Result<ProgramStatus, ClientError> {
        match self.exchange(&Request::Status)? {
            Reply::Status(status) => Ok(ProgramStatus::Switch(status)),
            Reply::Proxy(status) => Ok(ProgramStatus::Proxy(status)),
            _ => Err(ClientError::Malformed("another kind of reply".into())),
        }
    }

    fn exchange(&mut self, request: &Request) -> Result<Reply, ClientError> {
        let request = serde_json::to_string(&Versioned { v: VERSION, value: request });
        let line = request.map_err(|error| ClientError::Malformed(error.to_string()))? + "\n";
        // A daemon without a free slot says so and reads nothing.
        match self.stream.get_mut().write_all(line.as_bytes()) {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => return Err(broken(error)),
            _ => {}
        }
        self.reply()?.ok_or_else(|| ClientError::Broken(ErrorKind::UnexpectedEof.into()))
    }

    /// Reads the next line from the daemon; `None` if it has closed the connection.
    fn reply(&mut self) -> Result<Option<Reply>, ClientError> {
        let malformed = |error: serde_json::Error| ClientError::Malformed(error.to_string());
        let mut line = String::new();
        (&mut self.stream).take(MAX_REPLY).read_line(&mut line).map_err(broken)?;
        if line.is_empty() {
            return Ok(None);
        }
        if !line.ends_with('\n') {
            return Err(ClientError::Broken(ErrorKind::UnexpectedEof.into()));
        }
        let mut value: Value = serde_json::from_str(&line).map_err(malformed)?;
        check_version(&mut value).map_err(ClientError::Malformed)?;
        match serde_json::from_value(value).map_err(malformed)? {
            Reply::Error(failure) => Err(ClientError::Refused(failure)),
            reply => Ok(Some(reply)),
        }
    }

    /// Subscribes to events from now on.
    pub fn monitor(mut self) -> Result<Events, ClientError> {
        self.exchange(&Request::Monitor)?;
        // A daemon may send no events for a long time.
        self.stream.get_mut().set_read_timeout(None).map_err(broken)?;
        Ok(Events(self))
    }
}

/// Events at the daemon's switch.
pub struct Events(Client);

impl Iterator for Events {
    type Item = Result<TimedEvent, ClientError>;

    /// Waits for the next event; `None` once the daemon has ended.
    fn next(&mut self) -> Option<Self::Item> {
        self.0
            .reply()
            .transpose()
            .map(|reply| reply?.try_into().map_err(|_| ClientError::Malformed("another kind of reply".into())))
    }
}
