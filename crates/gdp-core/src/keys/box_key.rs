//! The key of an entity that others wrap keys to and agree on keys with: it follows from the key
//! that the entity signs with, so that it needs no file and a restarted reader opens what was
//! wrapped before, but is another key, so that no signature helps with key agreement, or the other
//! way round.

use std::fmt;
use std::sync::Arc;

use zeroize::Zeroizing;

use crate::crypto;
use crate::crypto::{Backend, CryptoError, PUBLIC_KEY_LEN};

const CONTEXT: &[u8] = b"gdp/box-key/1";

/// A private P-256 key for key agreement. Clones share one copy, which is cleared with the last of
/// them.
#[derive(Clone)]
pub struct BoxKey(Arc<Inner>);

struct Inner {
    secret: Zeroizing<[u8; 32]>,
    public: [u8; PUBLIC_KEY_LEN],
}

impl BoxKey {
    /// `HKDF-SHA256(signing key, info = "gdp/box-key/1" ‖ i)` with the lowest `i`, of one byte, for
    /// which that is a key: 0 but for one in 2³².
    pub(crate) fn derive(signing_secret: &[u8; 32]) -> Result<Self, CryptoError> {
        for i in 0..=u8::MAX {
            let secret = Backend::default().hkdf_sha256(&[], signing_secret, &[CONTEXT, &[i]])?;
            if let Ok(public) = Backend::default().agreement_public(&secret) {
                return Ok(Self(Arc::new(Inner { secret, public })));
            }
        }
        Err(CryptoError::BadPrivateKey)
    }

    /// The public key, SEC1 compressed.
    pub fn public(&self) -> [u8; PUBLIC_KEY_LEN] {
        self.0.public
    }

    /// What was sealed for this key with [`crypto::hpke_seal`].
    pub fn open(&self, info: &[u8], sealed: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        crypto::hpke_open(&self.0.secret, info, sealed)
    }

    /// The secret that this key and the private key of `peer` (SEC1 compressed) have in common.
    pub fn agree(&self, peer: &[u8; PUBLIC_KEY_LEN]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
        Backend::default().agree(&self.0.secret, peer)
    }
}

impl fmt::Debug for BoxKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "BoxKey(public {})", hex::encode(self.0.public))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/keys/box_key.rs"]
mod tests;
