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
        Self::new(code.into(), &reason)
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
    /// A message that the other side does not understand, or may not receive from this one.
    Malformed,
    /// The entity has to attach first.
    NotAttached,
    /// A signature does not verify under the key it must verify under.
    BadSignature,
    /// The name does not follow from the key and digest, or a certificate is for another name.
    WrongName,
    /// A certificate or statement is for, or by, another entity.
    WrongEntity,
    /// A certificate or statement is for another switch.
    WrongSwitch,
    /// A certificate is not valid yet.
    NotYetValid,
    /// A certificate has expired.
    Expired,
    /// The owner has revoked the certificate.
    Revoked,
    /// The delegation, membership or role that the certificate needs is missing.
    NotEntitled,
    /// The serial of a statement, or the number of a revocation, is not above the newest known one.
    ReplayedSerial,
    /// The RIB knows nothing of the name.
    NotFound,
    /// A bound of the RIB or the switch is reached.
    Limit,
    /// The switch has no path to the RIB, or to the peer, now. Try again later.
    Unreachable,
    /// This release does not do that.
    Unsupported,
    /// It comes from a RIB that another one has replaced.
    Fenced,
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self:?}")
    }
}

impl From<RefusalCode> for ErrorCode {
    fn from(code: RefusalCode) -> Self {
        match code {
            RefusalCode::Malformed => Self::Malformed,
            RefusalCode::NotAttached => Self::NotAttached,
            RefusalCode::BadSignature => Self::BadSignature,
            RefusalCode::WrongName => Self::WrongName,
            RefusalCode::WrongEntity => Self::WrongEntity,
            RefusalCode::WrongSwitch => Self::WrongSwitch,
            RefusalCode::NotYetValid => Self::NotYetValid,
            RefusalCode::Expired => Self::Expired,
            RefusalCode::Revoked => Self::Revoked,
            RefusalCode::NotEntitled => Self::NotEntitled,
            RefusalCode::ReplayedSerial => Self::ReplayedSerial,
            RefusalCode::NotFound => Self::NotFound,
            RefusalCode::Limit => Self::Limit,
            RefusalCode::Unreachable => Self::Unreachable,
            RefusalCode::Unsupported => Self::Unsupported,
            RefusalCode::Fenced => Self::Fenced,
        }
    }
}
