//! The messages between proxies about a service or an action: requests and replies, sealed between
//! one client and one server (`gdp::unstable::Client`, `Server`).
//!
//! A client's proxy first requests the description of the service. Its calls then use the types and
//! the encoding of the server's ROS graph. The client's proxy converts if its own graph has the
//! other ROS version. The [`Epoch`] of a call names the description that it relies on.

use bytes::Bytes;
use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_e2e::seal::{Encoding, MessageId};
use serde::{Deserialize, Serialize};

use crate::roster::{Kind, MAX_DEFINITION, MAX_NODE};

/// Encoding number of a message that is a request or a reply.
pub const CALL: Encoding = Encoding::Other(0x4753);

const VERSION: u8 = 2;

/// Maximum length of a failure's text, in bytes.
pub const MAX_TEXT: usize = 1024;

/// Maximum number of events in one reply.
pub const MAX_EVENTS: usize = 256;

const MAX_KIND: usize = 256;
const MAX_HASH: usize = 32;
const MAX_DESCRIPTION: usize = 2 * MAX_DEFINITION + MAX_KIND + MAX_HASH + MAX_NODE + 128;

/// A random number that identifies one offer of a server. The server's proxy draws a new one each
/// time that it offers the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Epoch(pub u64);

/// A request to the server's proxy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    Describe,
    /// A call. `body` has the encoding of the server's ROS version.
    Call {
        epoch: Epoch,
        part: Part,
        body: Bytes,
    },
    /// A request for the events of the caller's goals after number `after`. The server's proxy
    /// replies when there is an event, or after a timeout.
    Events {
        epoch: Epoch,
        after: u64,
    },
    /// The caller no longer needs the answer to this call of a service. There is no reply.
    Cancel(MessageId),
}

/// The ROS service that a call goes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The service itself.
    Service,
    /// The `send_goal` service of an action.
    SendGoal,
    CancelGoal,
    GetResult,
}

/// A reply of the server's proxy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    Description(Epoch, Description),
    /// The ROS server's response, unchanged.
    Answer(Bytes),
    Failure(Failure),
    Events(Events),
}

/// The description of a service or an action.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// The type of the service or action, with the hash of the whole type.
    pub kind: Kind,
    /// The full name of the server's node, such as `/robot/driver`. It is empty if the graph does
    /// not tell it.
    pub node: String,
    /// The definitions, if the server's proxy knows them.
    pub definitions: Option<Definitions>,
}

/// The definitions of a service's request and response, each with all nested types. Of an action,
/// `request` is the definition of the whole type, and `response` is empty.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Definitions {
    pub request: String,
    pub response: String,
}

/// The reason why a call has no response.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{}{text}", code.as_str(), if text.is_empty() { "" } else { ": " })]
pub struct Failure {
    pub code: FailureCode,
    /// A text for the user, of at most [`MAX_TEXT`] bytes.
    text: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FailureCode {
    /// The ROS server has left. It may have executed the request.
    ServerLeft,
    /// The ROS server reported a failure.
    Refused,
    /// The proxy's queue of calls to the ROS server is full.
    Busy,
    /// The name does not support the request.
    Malformed,
    /// The server has changed since it was described. The new server has not received the request.
    Changed,
}

/// Events of the goals of one caller.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Events {
    /// The number of the last event, from which the caller continues.
    pub last: u64,
    /// Number of events that were dropped since the previous reply, for lack of room.
    pub dropped: u64,
    pub events: Vec<Event>,
}

/// A message from a topic of an action, as the ROS server published it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    Feedback(Bytes),
    /// The statuses of the caller's goals only.
    Status(Bytes),
}

/// The reason why bytes are not a request or reply.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    #[error("a message about a service of version {0}, which this release does not know; update the proxy")]
    Version(u8),
    #[error("a message about a service that ends too early, or says what there is not")]
    Malformed,
    #[error("{what}: {got} where at most {most} are allowed")]
    TooMuch { what: &'static str, got: usize, most: usize },
    #[error(transparent)]
    Cbor(#[from] CborError),
}

impl Request {
    pub fn to_bytes(&self) -> Vec<u8> {
        match self {
            Self::Describe => vec![VERSION, 0],
            Self::Call { epoch, part, body } => [&[VERSION, 1, *part as u8][..], &epoch.0.to_be_bytes(), body].concat(),
            Self::Events { epoch, after } => [&[VERSION, 2][..], &epoch.0.to_be_bytes(), &after.to_be_bytes()].concat(),
            Self::Cancel(MessageId { session, sequence }) => {
                [&[VERSION, 3][..], session, &sequence.to_be_bytes()].concat()
            }
        }
    }

    /// Decodes a request from another proxy. The body shares the memory of `bytes`.
    pub fn from_bytes(bytes: &Bytes) -> Result<Self, CallError> {
        let mut from = Cursor::new(bytes)?;
        let request = match from.byte()? {
            0 => Self::Describe,
            1 => {
                let part = Part::from_u8(from.byte()?).ok_or(CallError::Malformed)?;
                Self::Call { part, epoch: Epoch(from.word()?), body: from.rest() }
            }
            2 => Self::Events { epoch: Epoch(from.word()?), after: from.word()? },
            3 => Self::Cancel(MessageId { session: from.session()?, sequence: from.word()? }),
            _ => return Err(CallError::Malformed),
        };
        from.end()?;
        Ok(request)
    }
}

impl Reply {
    pub fn to_bytes(&self) -> Result<Vec<u8>, CallError> {
        Ok(match self {
            Self::Description(epoch, description) => {
                description.check()?;
                [&[VERSION, 0][..], &epoch.0.to_be_bytes(), &cbor::encode(description)?].concat()
            }
            Self::Answer(body) => [&[VERSION, 1][..], body].concat(),
            Self::Failure(Failure { code, text }) => [&[VERSION, 2, *code as u8], text.as_bytes()].concat(),
            Self::Events(Events { last, dropped, events }) => {
                let mut bytes = [&[VERSION, 3][..], &last.to_be_bytes(), &dropped.to_be_bytes()].concat();
                for event in events {
                    let (kind, body) = match event {
                        Event::Feedback(body) => (0, body),
                        Event::Status(body) => (1, body),
                    };
                    let most = u32::MAX as usize;
                    let too_much = |_| CallError::TooMuch { what: "bytes of an event", got: body.len(), most };
                    bytes.push(kind);
                    bytes.extend(u32::try_from(body.len()).map_err(too_much)?.to_be_bytes());
                    bytes.extend(body);
                }
                bytes
            }
        })
    }

    /// Decodes a reply from another proxy. Bodies share the memory of `bytes`.
    pub fn from_bytes(bytes: &Bytes) -> Result<Self, CallError> {
        let mut from = Cursor::new(bytes)?;
        let reply = match from.byte()? {
            0 => {
                let epoch = Epoch(from.word()?);
                let description: Description = cbor::decode(&from.rest(), MAX_DESCRIPTION)?;
                description.check()?;
                Self::Description(epoch, description)
            }
            1 => Self::Answer(from.rest()),
            2 => {
                let code = FailureCode::from_u8(from.byte()?).ok_or(CallError::Malformed)?;
                let text = from.rest();
                bounded("bytes of a failure's text", text.len(), MAX_TEXT)?;
                let text = str::from_utf8(&text).map_err(|_| CallError::Malformed)?.to_owned();
                Self::Failure(Failure { code, text })
            }
            3 => {
                let (last, dropped, mut events) = (from.word()?, from.word()?, Vec::new());
                while !from.0.is_empty() {
                    bounded("events", events.len() + 1, MAX_EVENTS)?;
                    events.push(from.event()?);
                }
                Self::Events(Events { last, dropped, events })
            }
            _ => return Err(CallError::Malformed),
        };
        from.end()?;
        Ok(reply)
    }

    pub fn failure(code: FailureCode, text: impl ToString) -> Self {
        Self::Failure(Failure::new(code, text))
    }
}

impl Failure {
    /// Creates a failure with at most the first [`MAX_TEXT`] bytes of `text`.
    pub fn new(code: FailureCode, text: impl ToString) -> Self {
        let mut text = text.to_string();
        text.truncate(text.floor_char_boundary(MAX_TEXT));
        Self { code, text }
    }

    pub fn text(&self) -> &str {
        &self.text
    }
}

impl Part {
    fn from_u8(number: u8) -> Option<Self> {
        [Self::Service, Self::SendGoal, Self::CancelGoal, Self::GetResult].get(usize::from(number)).copied()
    }
}

impl FailureCode {
    const ALL: [Self; 5] = [Self::ServerLeft, Self::Refused, Self::Busy, Self::Malformed, Self::Changed];

    fn from_u8(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    fn as_str(self) -> &'static str {
        match self {
            Self::ServerLeft => "the server has gone, and may have carried the request out",
            Self::Refused => "the server failed",
            Self::Busy => "as many calls as may wait for the server",
            Self::Malformed => "the server's proxy does not take the request",
            Self::Changed => "the server has been replaced by another, and has not seen the request",
        }
    }
}

impl Description {
    fn check(&self) -> Result<(), CallError> {
        bounded("bytes of a type's name", self.kind.name.len(), MAX_KIND)?;
        bounded("bytes of a type's hash", self.kind.hash.len(), MAX_HASH)?;
        bounded("bytes of a node's name", self.node.len(), MAX_NODE)?;
        let texts = self.definitions.iter().flat_map(|Definitions { request, response }| [request, response]);
        texts.map(String::len).try_for_each(|length| bounded("bytes of a definition", length, MAX_DEFINITION))
    }
}

fn bounded(what: &'static str, got: usize, most: usize) -> Result<(), CallError> {
    if got > most { Err(CallError::TooMuch { what, got, most }) } else { Ok(()) }
}

/// The bytes that are still to decode.
struct Cursor(Bytes);

impl Cursor {
    fn new(bytes: &Bytes) -> Result<Self, CallError> {
        let mut cursor = Self(bytes.clone());
        match cursor.byte()? {
            VERSION => Ok(cursor),
            other => Err(CallError::Version(other)),
        }
    }

    fn take(&mut self, length: usize) -> Result<Bytes, CallError> {
        if length > self.0.len() { Err(CallError::Malformed) } else { Ok(self.0.split_to(length)) }
    }

    fn byte(&mut self) -> Result<u8, CallError> {
        self.take(1).map(|byte| byte[0])
    }

    fn word(&mut self) -> Result<u64, CallError> {
        let bytes = self.take(8)?;
        bytes[..].try_into().map(u64::from_be_bytes).map_err(|_| CallError::Malformed)
    }

    fn session(&mut self) -> Result<[u8; 16], CallError> {
        self.take(16)?[..].try_into().map_err(|_| CallError::Malformed)
    }

    fn event(&mut self) -> Result<Event, CallError> {
        let kind = self.byte()?;
        let length: [u8; 4] = self.take(4)?[..].try_into().map_err(|_| CallError::Malformed)?;
        let body = self.take(u32::from_be_bytes(length) as usize)?;
        match kind {
            0 => Ok(Event::Feedback(body)),
            1 => Ok(Event::Status(body)),
            _ => Err(CallError::Malformed),
        }
    }

    fn rest(&mut self) -> Bytes {
        std::mem::take(&mut self.0)
    }

    fn end(&self) -> Result<(), CallError> {
        if self.0.is_empty() { Ok(()) } else { Err(CallError::Malformed) }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/call.rs"]
mod tests;
