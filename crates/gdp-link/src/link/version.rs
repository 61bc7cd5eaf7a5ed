//! Versions of what passes over a link: control messages and frames. ALPN negotiates one, by names
//! `gdp/N`.

use quinn::crypto::rustls::HandshakeData;
use quinn::{Connection, VarInt};

use crate::link::error::LinkError;

/// The versions that a node speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Versions {
    pub oldest: u8,
    pub newest: u8,
}

impl Versions {
    /// The versions of this release. From version 2 on, a node speaks its own version and the one
    /// before, so that a network can be upgraded node by node. No node speaks version 1 any more.
    pub const SPOKEN: Self = Self { oldest: 2, newest: 2 };

    /// Returns the ALPN names to offer, the best first.
    ///
    /// They include versions that are not spoken any more. A peer that speaks nothing newer then
    /// gets a link whose end says why, instead of an alert of TLS.
    pub fn offered(self) -> Vec<Vec<u8>> {
        (1..=self.newest).rev().map(|version| format!("gdp/{version}").into_bytes()).collect()
    }

    /// Returns the negotiated version. Closes the connection if it is not spoken any more.
    pub fn negotiated(self, connection: &Connection) -> Result<u8, LinkError> {
        let handshake = connection.handshake_data().and_then(|any| any.downcast::<HandshakeData>().ok());
        let protocol = handshake.and_then(|handshake| handshake.protocol).unwrap_or_default();
        let version = self.offered().iter().rev().position(|offered| *offered == protocol).map(|at| at as u8 + 1);
        let version = version.ok_or_else(|| LinkError::Handshake("the peer negotiated no version".into()))?;
        if version >= self.oldest {
            return Ok(version);
        }
        let Self { oldest, newest } = self;
        let reason = format!(
            "gdp/{version} is the newest version that both sides know, and the other side speaks gdp/{oldest} to \
             gdp/{newest} only; upgrade this side"
        );
        connection.close(VarInt::from_u32(0), reason.as_bytes());
        Err(LinkError::OldVersion { theirs: version, oldest, newest })
    }
}

#[cfg(test)]
#[path = "../../tests/unit/link/version.rs"]
mod tests;
