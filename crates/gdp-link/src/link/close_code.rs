//! Codes with which a side closes a link, for programs; the reason beside it is for people.

use quinn::VarInt;

/// Application error code of a link's QUIC connection (RFC 9000, section 19.19). A peer that does
/// not know a code treats it as [`Self::Ended`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloseCode {
    /// The link has ended without a fault: it was replaced, is not used, or this side stops.
    Ended = 0,
    /// The negotiated version is not spoken any more.
    Version = 1,
    /// The peer's hello breaks the protocol.
    Malformed = 2,
    /// Another peer was expected.
    WrongPeer = 3,
    /// The hellos were not exchanged in time, or other handshakes took the place of this one.
    Timeout = 4,
    /// This side has no room for another link.
    Full = 5,
    /// The peer's credentials do not permit the link, or do not any more.
    NotAdmitted = 6,
    /// Another program that runs uses the peer's key.
    KeyInUse = 7,
}

impl From<CloseCode> for VarInt {
    fn from(code: CloseCode) -> Self {
        Self::from_u32(code as u32)
    }
}
