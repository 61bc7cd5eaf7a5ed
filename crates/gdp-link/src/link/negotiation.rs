//! The version that the handshake of a link has negotiated.

use quinn::Connection;
use quinn::crypto::rustls::HandshakeData;

use crate::link::close_code::CloseCode;
use crate::link::error::LinkError;
use crate::link::version::Versions;

/// Returns the negotiated version. Closes the connection if it is none of `spoken` any more.
pub fn negotiated(spoken: Versions, connection: &Connection) -> Result<u8, LinkError> {
    let handshake = connection.handshake_data().and_then(|any| any.downcast::<HandshakeData>().ok());
    let protocol = handshake.and_then(|handshake| handshake.protocol).unwrap_or_default();
    let version = spoken.offered().iter().rev().position(|offered| *offered == protocol).map(|at| at as u8 + 1);
    let version = version.ok_or_else(|| LinkError::Handshake("the peer negotiated no version".into()))?;
    let Versions { oldest, newest } = spoken;
    if version >= oldest {
        return Ok(version);
    }
    let reason = format!(
        "gdp/{version} is the newest version that both sides know, and the other side speaks gdp/{oldest} to \
         gdp/{newest} only; upgrade this side"
    );
    connection.close(CloseCode::Version.into(), reason.as_bytes());
    Err(LinkError::OldVersion { theirs: version, oldest, newest })
}
