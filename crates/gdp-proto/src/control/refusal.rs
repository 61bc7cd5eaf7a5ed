//! What a RIB refuses, and why.

use serde::{Deserialize, Serialize};

/// Why a request was refused: a code for programs and a sentence that names the thing and the
/// remedy for people.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{reason}")]
pub struct Refusal {
    pub code: RefusalCode,
    pub reason: String,
}

impl Refusal {
    /// A refusal with this code and sentence; an overlong sentence is cut, so that it always fits a
    /// response.
    pub fn new(code: RefusalCode, reason: impl Into<String>) -> Self {
        const LONGEST: usize = 1024;
        let mut reason = reason.into();
        if reason.len() > LONGEST {
            reason.truncate(reason.floor_char_boundary(LONGEST));
        }
        Self { code, reason }
    }
}

/// What kind of refusal it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum RefusalCode {
    /// Not a message this side understands, or not one that this peer may send.
    Malformed,
    /// The entity has to attach first.
    NotAttached,
    /// A signature does not verify under the key it must verify under.
    BadSignature,
    /// The name is not derived from the key and digest shown, or a certificate is for another name.
    WrongName,
    /// A certificate or statement is for, or by, another entity.
    WrongEntity,
    /// A certificate or statement is for another switch.
    WrongSwitch,
    NotYetValid,
    Expired,
    /// The owner has revoked the certificate.
    Revoked,
    /// The delegation, membership or role that the certificate needs is not there.
    NotEntitled,
    /// The serial of the statement is not above the floor of its entity, or a revocation older than
    /// the one known.
    ReplayedSerial,
    /// Nothing is known of the name.
    NotFound,
    /// A bound of the RIB or the switch is reached.
    Limit,
    /// The switch has no way to the RIB, or to the peer, right now; worth another attempt later.
    Unreachable,
    /// Something that this release does not do.
    Unsupported,
    /// It comes from a RIB that another one has taken the place of.
    Fenced,
}
