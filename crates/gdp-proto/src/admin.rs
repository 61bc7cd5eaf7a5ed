//! What commands and the daemon say to each other over the admin socket: `{"v":1,"op":…}` and
//! `{"v":1,"ok"|"control"|"error":…}`, a JSON object to a line. Types only: the daemon serves, the
//! command line asks.

use crate::control::{EntityRequest, RecordKey, Response};
use gdp_core::name::{NamePrefix, NameProof};
use gdp_wire::Name;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The version of this protocol.
pub const VERSION: u64 = 1;

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
    /// From now on, what happens: the connection brings `Event`s, until the client closes it.
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

/// What the daemon answers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reply {
    Ok(Value),
    Control(Response),
    Error { code: String, reason: String },
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
