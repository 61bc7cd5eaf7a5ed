//! The messages between proxies about a service or an action: requests and replies between one
//! client and one server, sealed for these two (`gdp::Client`, `Server`).
//!
//! One who calls first asks to have the service described; a call then goes in the terms of the
//! server's ROS graph, and the caller's proxy converts if its own graph is of the other ROS
//! version. [`Epoch`] says by which description.

use bytes::Bytes;
use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_e2e::seal::Encoding;
use serde::{Deserialize, Serialize};

use crate::roster::{Kind, MAX_DEFINITION};

/// How a message is marked that is a request or a reply.
pub const CALL: Encoding = Encoding::Other(0x4753);

const VERSION: u8 = 1;

/// Bytes of what a failure says.
pub const MAX_TEXT: usize = 1024;

/// Events in one reply.
pub const MAX_EVENTS: usize = 256;

const MAX_KIND: usize = 256;
const MAX_HASH: usize = 32;
const MAX_DESCRIPTION: usize = 2 * MAX_DEFINITION + MAX_KIND + MAX_HASH + 128;

/// Which time it is that a server is offered: drawn at random each time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Epoch(pub u64);

/// What is asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    Describe,
    /// `body`: as a client of the server's ROS version would send it.
    Call {
        epoch: Epoch,
        part: Part,
        body: Bytes,
    },
    /// What happened to the caller's goals after the event of this number; answered when there is
    /// something, or after a while.
    Events {
        epoch: Epoch,
        after: u64,
    },
}

/// Which service of those that the name stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The one there is.
    Service,
    /// Of an action.
    SendGoal,
    CancelGoal,
    GetResult,
}

/// What is answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    Description(Epoch, Description),
    /// As the server sent it.
    Answer(Bytes),
    Failure(Failure),
    Events(Events),
}

/// What a server serves.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// Its name is that of the service or action; the hash is that of all its parts.
    pub kind: Kind,
    /// Of a service, if the server's proxy knows it.
    pub definitions: Option<Definitions>,
}

/// The texts that the two messages of a service are defined by, each with all types that it
/// contains.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Definitions {
    pub request: String,
    pub response: String,
}

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{}{text}", code.as_str(), if text.is_empty() { "" } else { ": " })]
pub struct Failure {
    pub code: FailureCode,
    /// For people; at most [`MAX_TEXT`] bytes.
    text: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FailureCode {
    /// The ROS server has gone; it may have carried the request out.
    ServerLeft,
    /// The ROS server says that it failed.
    Refused,
    /// As many calls as the proxy holds wait for the ROS server.
    Busy,
    /// The request is not one that this name takes.
    Malformed,
    /// The server is another than the one that was described. It has not seen the request.
    Changed,
}

/// What happened to the goals of one caller.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Events {
    /// To ask from next.
    pub last: u64,
    /// Those that there was no room for, since the reply before.
    pub dropped: u64,
    pub events: Vec<Event>,
}

/// A message of one of an action's topics, as its server published it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    Feedback(Bytes),
    /// Of the caller's goals alone.
    Status(Bytes),
}

/// Bytes that no proxy of this version sends.
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
        }
    }

    /// Reads what another proxy sent. The body is a part of `bytes`.
    pub fn from_bytes(bytes: &Bytes) -> Result<Self, CallError> {
        let mut from = Cursor::new(bytes)?;
        let request = match from.byte()? {
            0 => Self::Describe,
            1 => {
                let part = Part::from_u8(from.byte()?).ok_or(CallError::Malformed)?;
                Self::Call { part, epoch: Epoch(from.word()?), body: from.rest() }
            }
            2 => Self::Events { epoch: Epoch(from.word()?), after: from.word()? },
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

    /// Reads what another proxy sent. Bodies are parts of `bytes`.
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
    /// Of the text, as much as may be said.
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
        let texts = self.definitions.iter().flat_map(|Definitions { request, response }| [request, response]);
        texts.map(String::len).try_for_each(|length| bounded("bytes of a definition", length, MAX_DEFINITION))
    }
}

fn bounded(what: &'static str, got: usize, most: usize) -> Result<(), CallError> {
    if got > most { Err(CallError::TooMuch { what, got, most }) } else { Ok(()) }
}

/// What is left to read.
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
