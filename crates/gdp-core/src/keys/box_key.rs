//! Box key of an entity, to which others wrap keys and with which they agree on keys. It is derived
//! from the signing key, so it needs no file, and a restarted reader can open earlier boxes. It is
//! a separate key, so that signatures do not weaken key agreement, or the reverse.

use std::fmt;
use std::sync::Arc;

use zeroize::Zeroizing;

use crate::crypto;
use crate::crypto::{CryptoError, PUBLIC_KEY_LEN};

const CONTEXT: &[u8] = b"gdp/box-key/1";

/// Private P-256 key for key agreement. Clones share one copy, which is cleared with the last of
/// them.
#[derive(Clone)]
pub struct BoxKey(Arc<Inner>);

struct Inner {
    secret: Zeroizing<[u8; 32]>,
    public: [u8; PUBLIC_KEY_LEN],
}

impl BoxKey {
    /// Derives `HKDF-SHA256(signing key, info = "gdp/box-key/1" ‖ i)`. `i` is the lowest byte for
    /// which the result is a valid key: 0 except for one in 2³².
    pub(crate) fn derive(signing_secret: &[u8; 32]) -> Result<Self, CryptoError> {
        for i in 0..=u8::MAX {
            let secret = crypto::hkdf_sha256(&[], signing_secret, &[CONTEXT, &[i]])?;
            if let Ok(public) = crypto::agreement_public(&secret) {
                return Ok(Self(Arc::new(Inner { secret, public })));
            }
        }
        Err(CryptoError::BadPrivateKey)
    }

    /// Returns the public key, SEC1 compressed.
    pub fn public(&self) -> [u8; PUBLIC_KEY_LEN] {
        self.0.public
    }

    /// Decrypts what [`crypto::hpke_seal`] sealed for this key.
    pub fn open(&self, info: &[u8], sealed: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        crypto::hpke_open(&self.0.secret, info, sealed)
    }

    /// Returns the shared secret of this key and the private key of `peer` (public key SEC1
    /// compressed).
    pub fn agree(&self, peer: &[u8; PUBLIC_KEY_LEN]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
        crypto::agree(&self.0.secret, peer)
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
