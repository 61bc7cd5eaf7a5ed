//! What commands and the daemon say to each other over the admin socket: `{"v":1,"op":…}` and `{"v":1,"ok"|"control"|"error":…}`,
//! a JSON object to a line. Types and the client; the server is [`crate::serve::admin`].

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use gdp::control::{EntityRequest, RecordPlace, Response};
use gdp::name::{NamePrefix, NameProof};
use gdp_wire::Name;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The version of this protocol.
const VERSION: u64 = 1;

/// Longest request, in bytes: certificates as hex, with room.
pub const MAX_REQUEST: usize = 64 * 1024;

/// Longest reply: a page of records.
const MAX_REPLY: u64 = 16 * 1024 * 1024;

/// Entries in one reply of a dump.
pub const PAGE: usize = 1000;

/// A daemon that takes longer than this is not well.
const PATIENCE: Duration = Duration::from_secs(15);

/// What a command asks.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "op", rename_all = "lowercase")]
pub enum Request {
    Status,
    Links,
    /// Those that this switch has, or is to have, links with, and why there is none.
    Peers,
    /// Where a name is.
    Locate {
        what: NamePrefix,
    },
    /// One echo to a neighbour.
    Echo {
        peer: Name,
    },
    /// One probe for a name, toward an egress switch.
    Probe {
        name: Name,
        switch: Name,
        hops: u8,
    },
    /// The way of a name on, from the border switch of this domain that has a link to this one of another domain.
    Beyond {
        name: Name,
        border: Name,
        domain: Name,
        peer: Name,
    },
    /// From now on, what happens: the connection brings [`Event`](crate::serve::events::Event)s, until the client closes it.
    Monitor,
    /// What the switch knows of the domain's switches.
    Topology,
    /// A page of the data plane's routes, behind this name.
    Fib {
        after: Option<Name>,
    },
    /// A page of the RIB's records, behind this one.
    Rib {
        after: Option<RecordPlace>,
    },
    /// Something an entity asks of the RIB, through this daemon's switch.
    Entity {
        entity: Option<NameProof>,
        request: Box<EntityRequest>,
    },
}

/// What the daemon answers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reply {
    Ok(Value),
    Control(Response),
    Error { code: String, reason: String },
}

/// Why a command got no answer that helps it.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    #[error(
        "no daemon answers at {}: {source}; start one with `gdp-ctl serve`, or say where it is with --socket", path.display()
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
        stream.set_read_timeout(Some(PATIENCE)).map_err(ClientError::Broken)?;
        stream.set_write_timeout(Some(PATIENCE)).map_err(ClientError::Broken)?;
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

    /// Waits for the next [`Event`](crate::serve::events::Event); none once the daemon has ended.
    fn next(&mut self) -> Option<Self::Item> {
        self.0.reply().transpose().map(|reply| match reply? {
            Reply::Ok(event) => Ok(event),
            _ => Err(ClientError::Malformed("another kind of reply".into())),
        })
    }
}

/// The request in a line from a client.
pub fn parse_request(line: &[u8]) -> Result<Request, String> {
    let mut value: Value = serde_json::from_slice(line).map_err(|error| format!("not JSON: {error}"))?;
    check_version(&mut value)?;
    serde_json::from_value(value).map_err(|error| format!("not a request this daemon knows: {error}"))
}

/// The line that carries a reply.
pub fn reply_line(reply: &Reply) -> String {
    let value = serde_json::to_value(reply).and_then(|mut value| {
        value["v"] = VERSION.into();
        serde_json::to_string(&value)
    });
    let line = value.unwrap_or_else(|error| {
        json!({"v": VERSION, "error": {"code": "failed", "reason": error.to_string()}}).to_string()
    });
    line + "\n"
}

/// Takes the version out, if it is this one.
fn check_version(value: &mut Value) -> Result<(), String> {
    let object = value.as_object_mut().ok_or("not a JSON object")?;
    match object.remove("v").and_then(|v| v.as_u64()) {
        Some(VERSION) => Ok(()),
        Some(other) => Err(format!("protocol version {other}, but this program speaks version {VERSION}")),
        None => Err("no protocol version: \"v\": 1 is missing".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_and_replies_survive_their_line() {
        let after = Some(Name::from_bytes([7; 32]));
        for request in [Request::Status, Request::Fib { after }, Request::Rib { after: None }] {
            let mut value = serde_json::to_value(&request).unwrap();
            value["v"] = 1.into();
            let parsed = parse_request(value.to_string().as_bytes()).unwrap();
            assert_eq!(format!("{parsed:?}"), format!("{request:?}"));
        }
        let line = reply_line(&Reply::Control(Response::Attached { serial: 9 }));
        assert_eq!(line, "{\"control\":{\"Attached\":{\"serial\":9}},\"v\":1}\n");
    }

    #[test]
    fn what_is_not_a_request_is_named() {
        for (line, needle) in [
            ("", "not JSON"),
            ("[]", "not a JSON object"),
            ("{\"op\":\"status\"}", "\"v\": 1 is missing"),
            ("{\"v\":2,\"op\":\"status\"}", "version 2"),
            ("{\"v\":1,\"op\":\"reboot\"}", "reboot"),
            ("{\"v\":1,\"op\":\"fib\",\"after\":\"75e\"}", "64 hex digits"),
        ] {
            let error = parse_request(line.as_bytes()).expect_err(line);
            assert!(error.contains(needle), "{line}: {error}");
        }
    }
}
