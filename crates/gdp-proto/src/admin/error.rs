//! Why a request or command failed: a code for programs, and sentences for people.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::control::{Refusal, RefusalCode};

/// Why something failed, as the daemon answers it and as `gdp-ctl -j` prints it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorReply {
    pub code: ErrorCode,
    /// What is wrong, for people.
    pub reason: String,
    /// What to do about it, if anything is known.
    pub remedy: Option<String>,
}

impl ErrorReply {
    /// Splits a message at its last semicolon. By this project's convention, the remedy follows it.
    /// A message from elsewhere may have a second half of another kind there.
    pub fn new(code: ErrorCode, message: &str) -> Self {
        let (reason, remedy) = match message.rsplit_once("; ") {
            Some((reason, remedy)) => (reason, Some(remedy.to_owned())),
            None => (message, None),
        };
        Self { code, reason: reason.to_owned(), remedy }
    }

    /// The message as people read it on one line.
    pub fn message(&self) -> String {
        match &self.remedy {
            Some(remedy) => format!("{}; {remedy}", self.reason),
            None => self.reason.clone(),
        }
    }
}

impl From<Refusal> for ErrorReply {
    fn from(Refusal { code, reason }: Refusal) -> Self {
        Self::new(ErrorCode::Refused(code), &reason)
    }
}

/// What kind of failure it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum ErrorCode {
    /// The command line is wrong: exit status 2.
    Usage,
    /// No daemon answers at the admin socket: exit status 3.
    NoDaemon,
    /// This user may not use the daemon's admin socket.
    NotAllowed,
    /// The daemon closed the connection.
    Disconnected,
    /// Any other cause, which `reason` states.
    Failed,
    /// The daemon, or a RIB behind it, refused the request.
    #[serde(untagged)]
    Refused(RefusalCode),
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(code) => write!(f, "{code:?}"),
            code => write!(f, "{code:?}"),
        }
    }
}
