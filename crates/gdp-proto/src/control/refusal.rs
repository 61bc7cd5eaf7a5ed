//! Refusals of requests, with their reasons.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Refusal of a request: a code for programs, and for people a sentence that names the cause and
/// the remedy.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{reason}")]
pub struct Refusal {
    pub code: RefusalCode,
    pub reason: String,
}

impl Refusal {
    /// Creates a refusal. An overlong reason is truncated, so that it always fits a response.
    pub fn new(code: RefusalCode, reason: impl Into<String>) -> Self {
        const LONGEST: usize = 1024;
        let mut reason = reason.into();
        if reason.len() > LONGEST {
            reason.truncate(reason.floor_char_boundary(LONGEST));
        }
        Self { code, reason }
    }
}

/// Kind of a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
pub enum RefusalCode {
    /// The message is not understood, or this peer may not send it.
    Malformed,
    /// The entity must attach first.
    NotAttached,
    /// A signature does not verify under the required key.
    BadSignature,
    /// The name is not derived from the given key and digest, or a certificate is for another name.
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
    /// The serial of the statement is not above the floor of its entity, or the revocation is older
    /// than the known one.
    ReplayedSerial,
    /// The name is unknown.
    NotFound,
    /// A limit of the RIB or the switch is reached.
    Limit,
    /// The switch has no path to the RIB or to the peer at present. Retry later.
    Unreachable,
    /// This release does not support the request.
    Unsupported,
    /// The message comes from a RIB that another one has replaced.
    Fenced,
}
