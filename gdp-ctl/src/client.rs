//! The command line's end of the admin socket.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use gdp_proto::admin::{MAX_REPLY, Reply, Request, VERSION, check_version};
use gdp_proto::control::Response;
use serde_json::Value;

/// A daemon that takes longer than this is not well.
const TIMEOUT: Duration = Duration::from_secs(15);

/// Why a command got no answer that helps it.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    #[error(
        "no daemon answers at {}: {source}; start one with `gdp-ctl serve`, or say where it is with \
         --socket", path.display()
    )]
    NoDaemon { path: PathBuf, source: std::io::Error },
    #[error("not allowed to use the daemon's socket {}; run this as the user who runs the daemon", .0.display())]
    NotAllowed(PathBuf),
    #[error("the daemon went away: {0}")]
    Broken(std::io::Error),
    #[error("the daemon gave an answer that this program does not understand: {0}")]
    Malformed(String),
    #[error("refused ({code}): {reason}")]
    Refused { code: String, reason: String },
}

/// A connection to the daemon.
pub struct Client {
    stream: BufReader<UnixStream>,
}

impl Client {
    pub fn connect(path: &Path) -> Result<Self, ClientError> {
        let stream = UnixStream::connect(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::PermissionDenied => ClientError::NotAllowed(path.into()),
            _ => ClientError::NoDaemon { path: path.into(), source },
        })?;
        stream.set_read_timeout(Some(TIMEOUT)).map_err(ClientError::Broken)?;
        stream.set_write_timeout(Some(TIMEOUT)).map_err(ClientError::Broken)?;
        Ok(Self { stream: BufReader::new(stream) })
    }

    /// Asks, and turns a refusal into an error.
    pub fn ask(&mut self, request: &Request) -> Result<Reply, ClientError> {
        let malformed = |error: serde_json::Error| ClientError::Malformed(error.to_string());
        let mut value = serde_json::to_value(request).map_err(malformed)?;
        value["v"] = VERSION.into();
        self.stream.get_mut().write_all(format!("{value}\n").as_bytes()).map_err(ClientError::Broken)?;
        self.reply()?.ok_or_else(|| ClientError::Broken(std::io::ErrorKind::UnexpectedEof.into()))
    }

    /// The next line from the daemon; none if it has closed the connection.
    fn reply(&mut self) -> Result<Option<Reply>, ClientError> {
        let malformed = |error: serde_json::Error| ClientError::Malformed(error.to_string());
        let mut line = String::new();
        (&mut self.stream).take(MAX_REPLY).read_line(&mut line).map_err(ClientError::Broken)?;
        if line.is_empty() {
            return Ok(None);
        }
        if !line.ends_with('\n') {
            return Err(ClientError::Broken(std::io::ErrorKind::UnexpectedEof.into()));
        }
        let mut value: Value = serde_json::from_str(&line).map_err(malformed)?;
        check_version(&mut value).map_err(ClientError::Malformed)?;
        match serde_json::from_value(value).map_err(malformed)? {
            Reply::Error { code, reason } => Err(ClientError::Refused { code, reason }),
            reply => Ok(Some(reply)),
        }
    }

    /// Asks to be told what happens from now on.
    pub fn monitor(mut self) -> Result<Happenings, ClientError> {
        self.ask_value(&Request::Monitor)?;
        // It may be quiet for long.
        self.stream.get_mut().set_read_timeout(None).map_err(ClientError::Broken)?;
        Ok(Happenings(self))
    }

    /// Asks for a JSON value.
    pub fn ask_value(&mut self, request: &Request) -> Result<Value, ClientError> {
        match self.ask(request)? {
            Reply::Ok(value) => Ok(value),
            _ => Err(ClientError::Malformed("another kind of reply".into())),
        }
    }

    /// Asks for what the RIB says.
    pub fn ask_control(&mut self, request: &Request) -> Result<Response, ClientError> {
        match self.ask(request)? {
            Reply::Control(response) => Ok(response),
            _ => Err(ClientError::Malformed("another kind of reply".into())),
        }
    }
}

/// What happens at the daemon.
pub struct Happenings(Client);

impl Iterator for Happenings {
    type Item = Result<Value, ClientError>;

    /// Waits for the next [`Event`](gdp_daemon::serve::events::Event); none once the daemon has
    /// ended.
    fn next(&mut self) -> Option<Self::Item> {
        self.0.reply().transpose().map(|reply| match reply? {
            Reply::Ok(event) => Ok(event),
            _ => Err(ClientError::Malformed("another kind of reply".into())),
        })
    }
}
