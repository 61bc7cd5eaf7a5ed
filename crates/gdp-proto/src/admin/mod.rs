//! What commands and the daemon say to each other over the admin socket, a JSON object to a line. A
//! proxy has such a socket too, and answers `status` alone.
//!
//! A request is `{"v":2,"op":…}`, and a reply `{"v":2,REPLY:…}`, where REPLY names what follows:
//! `status`, `links` …, `control` or `error`. Types only: the daemon serves, the command line asks.
//! The command line prints most of the same types with `-j`.

pub mod error;
pub mod event;
pub mod links;
pub mod proxy;
pub mod status;
pub mod tables;
pub mod topology;
pub mod trace;
pub mod words;

use crate::control::{EntityRequest, RecordKey, RefusalCode, Response};
use error::{ErrorCode, ErrorReply};
use event::TimedEvent;
use gdp_core::name::{NamePrefix, NameProof};
use gdp_wire::Name;
use links::{LinksReply, PeersReply};
use proxy::ProxyReply;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use status::{HelloReply, StatusReply};
use tables::{FibReply, RibReply};
use topology::TopologyReply;
use trace::{BeyondReply, EchoReply, LocateReply, ProbeReply};

/// The version of this protocol.
pub const VERSION: u64 = 2;

/// Longest request, in bytes: certificates as hex, with room.
pub const MAX_REQUEST: usize = 64 * 1024;

/// Longest reply: a page of records.
pub const MAX_REPLY: u64 = 16 * 1024 * 1024;

/// Entries in one reply of a dump.
pub const PAGE: usize = 1000;

/// What a command asks.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "op", rename_all = "lowercase")]
pub enum Request {
    /// Which switch this is, and where it takes links over UDP.
    Hello,
    /// The state of a switch, or of a proxy at its own socket.
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
    /// The way of a name on, from the border switch of this domain that has a link to this one of
    /// another domain.
    Beyond {
        name: Name,
        border: Name,
        domain: Name,
        peer: Name,
    },
    /// From now on, what happens: the connection brings events, until the client closes it.
    Monitor,
    /// What the switch knows of the domain's switches.
    Topology,
    /// A page of the data plane's routes, behind this name.
    Fib {
        after: Option<Name>,
    },
    /// A page of the RIB's records, behind this one.
    Rib {
        after: Option<RecordKey>,
    },
    /// Something an entity asks of the RIB, through this daemon's switch.
    Entity {
        entity: Option<NameProof>,
        request: Box<EntityRequest>,
    },
}

/// Declares the replies, each of a type of its own, so that the type tells which one is meant.
macro_rules! replies {
    ($($variant:ident($of:ty),)+) => {
        /// What the daemon answers.
        #[derive(Clone, Debug, Serialize, Deserialize)]
        #[serde(rename_all = "lowercase")]
        pub enum Reply {
            $($variant($of),)+
            /// From now on there are events.
            Monitoring,
        }

        $(impl From<$of> for Reply {
            fn from(reply: $of) -> Self {
                Self::$variant(reply)
            }
        }

        impl TryFrom<Reply> for $of {
            type Error = Reply;

            fn try_from(reply: Reply) -> Result<Self, Reply> {
                match reply {
                    Reply::$variant(reply) => Ok(reply),
                    other => Err(other),
                }
            }
        })+
    };
}

replies! {
    Hello(HelloReply),
    Status(Box<StatusReply>),
    Links(LinksReply),
    Peers(PeersReply),
    Locate(LocateReply),
    Echo(EchoReply),
    Probe(ProbeReply),
    Beyond(BeyondReply),
    Event(TimedEvent),
    Topology(TopologyReply),
    Fib(FibReply),
    Rib(RibReply),
    Proxy(Box<ProxyReply>),
    Control(Response),
    Error(ErrorReply),
}

/// The request in a line from a client.
pub fn parse_request(line: &[u8]) -> Result<Request, String> {
    let mut value: Value = serde_json::from_slice(line).map_err(|error| format!("not JSON: {error}"))?;
    check_version(&mut value)?;
    serde_json::from_value(value).map_err(|error| format!("not a request this daemon knows: {error}"))
}

/// The line that carries a reply.
pub fn reply_line(reply: &Reply) -> String {
    let versioned = Versioned { v: VERSION, value: reply };
    let line = serde_json::to_string(&versioned).or_else(|error| {
        let failure = ErrorReply { code: ErrorCode::Failed, reason: error.to_string(), remedy: None };
        serde_json::to_string(&Versioned { v: VERSION, value: Reply::Error(failure) })
    });
    // Texts and numbers are always JSON.
    line.unwrap_or_default() + "\n"
}

/// The line for a client whose request is not answered.
pub fn refusal_line(code: RefusalCode, reason: &str) -> String {
    reply_line(&Reply::Error(ErrorReply::new(ErrorCode::Refused(code), reason)))
}

/// An object with the version of its form.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Versioned<T> {
    #[schemars(extend("const" = VERSION))]
    pub v: u64,
    #[serde(flatten)]
    pub value: T,
}

/// Takes the version out, if it is this one.
pub fn check_version(value: &mut Value) -> Result<(), String> {
    let object = value.as_object_mut().ok_or("not a JSON object")?;
    match object.remove("v").and_then(|v| v.as_u64()) {
        Some(VERSION) => Ok(()),
        Some(other) => Err(format!("protocol version {other}, but this program speaks version {VERSION}")),
        None => Err(format!("no protocol version: \"v\": {VERSION} is missing")),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/admin.rs"]
mod tests;
