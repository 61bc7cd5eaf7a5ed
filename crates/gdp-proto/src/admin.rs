//! Protocol between commands and the daemon over the admin socket. A request is `{"v":1,"op":…}`, a
//! reply `{"v":1,"ok"|"control"|"error":…}`, one JSON object per line. Types only: the daemon
//! serves, the command line asks.

use crate::control::{EntityRequest, RecordKey, Response};
use gdp_core::name::{NamePrefix, NameProof};
use gdp_wire::Name;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Version of this protocol.
pub const VERSION: u64 = 1;

/// Maximum bytes of a request: certificates as hex, with room to spare.
pub const MAX_REQUEST: usize = 64 * 1024;

/// Maximum bytes of a reply: a page of records.
pub const MAX_REPLY: u64 = 16 * 1024 * 1024;

/// Maximum number of entries in one reply of a dump.
pub const PAGE: usize = 1000;

/// Request of a command.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "op", rename_all = "lowercase")]
pub enum Request {
    Status,
    Links,
    /// Current and intended peers of this switch, with the reason where there is no link.
    Peers,
    /// Location of a name.
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
    /// Trace of a name beyond this domain, over the link of `border` to switch `peer` of another
    /// domain.
    Beyond {
        name: Name,
        border: Name,
        domain: Name,
        peer: Name,
    },
    /// Subscribes to events: the connection carries `Event`s until the client closes it.
    Monitor,
    /// The switch's view of the domain's switches.
    Topology,
    /// A page of the data plane's routes after this name.
    Fib {
        after: Option<Name>,
    },
    /// A page of the RIB's records after this one.
    Rib {
        after: Option<RecordKey>,
    },
    /// Request of an entity to the RIB, through this daemon's switch.
    Entity {
        entity: Option<NameProof>,
        request: Box<EntityRequest>,
    },
}

/// Reply of the daemon.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reply {
    Ok(Value),
    Control(Response),
    Error { code: String, reason: String },
}

/// Parses a request line of a client.
pub fn parse_request(line: &[u8]) -> Result<Request, String> {
    let mut value: Value = serde_json::from_slice(line).map_err(|error| format!("not JSON: {error}"))?;
    check_version(&mut value)?;
    serde_json::from_value(value).map_err(|error| format!("not a request this daemon knows: {error}"))
}

/// Formats a reply as a line.
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

/// Checks the protocol version and removes it from the object.
pub fn check_version(value: &mut Value) -> Result<(), String> {
    let object = value.as_object_mut().ok_or("not a JSON object")?;
    match object.remove("v").and_then(|v| v.as_u64()) {
        Some(VERSION) => Ok(()),
        Some(other) => Err(format!("protocol version {other}, but this program speaks version {VERSION}")),
        None => Err("no protocol version: \"v\": 1 is missing".into()),
    }
}

#[cfg(test)]
#[path = "../tests/unit/admin.rs"]
mod tests;
