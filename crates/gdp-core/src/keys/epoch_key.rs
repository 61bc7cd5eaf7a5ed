//! Epoch key: the secret that the writers and readers of a name share for an epoch. Session keys
//! are derived from it.

use crate::crypto;
use crate::crypto::{Aead, Backend, CryptoError};
use crate::name::Name;
use std::fmt;
use zeroize::Zeroizing;

/// Context string for deriving a session's key.
pub const SESSION_CONTEXT: &[u8] = b"gdp/session/1";

/// Context string for deriving the commitment to a session's key.
pub const COMMITMENT_CONTEXT: &[u8] = b"gdp/commit/1";

#[derive(Clone)]
pub struct EpochKey(Zeroizing<[u8; 32]>);

impl EpochKey {
    pub fn generate() -> Result<Self, CryptoError> {
        Ok(Self(Zeroizing::new(crypto::random()?)))
    }

    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(Zeroizing::new(bytes))
    }

    /// Creates a key from a slice. Returns `None` unless it has 32 bytes.
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        let mut key = Zeroizing::new([0u8; 32]);
        if bytes.len() != key.len() {
            return None;
        }
        key.copy_from_slice(bytes);
        Some(Self(key))
    }

    /// Returns the key bytes, only for wrapping them.
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Derives the key of a session. Cipher key and commitment are `HKDF-SHA256(epoch key, salt =
    /// session, info = context ‖ name ‖ writer)`, with the context "gdp/session/1" or
    /// "gdp/commit/1".
    pub fn session_key(
        &self,
        backend: Backend,
        name: &Name,
        writer: &Name,
        session: &[u8; 16],
    ) -> Result<SessionKey, CryptoError> {
        let derive = |context: &[u8]| {
            crypto::hkdf_sha256(session, self.0.as_slice(), &[context, name.as_bytes(), writer.as_bytes()])
        };
        let aead = backend.aead(&*derive(SESSION_CONTEXT)?)?;
        Ok(SessionKey { aead, commitment: *derive(COMMITMENT_CONTEXT)? })
    }
}

/// The key of a session in an epoch.
pub struct SessionKey {
    pub aead: Aead,
    /// Identifies the epoch key without revealing it: no two keys have the same commitment.
    /// AES-GCM alone does not commit, since one ciphertext may open under two keys. Signatures
    /// therefore cover the commitment.
    pub commitment: [u8; 32],
}

impl fmt::Debug for EpochKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("EpochKey(…)")
    }
}

#[cfg(test)]
#[path = "../../tests/unit/keys/epoch_key.rs"]
mod tests;
