//! The key of an entity that others wrap keys to and agree on keys with: it follows from the key that the entity signs with, so
//! that it needs no file and a restarted reader opens what was wrapped before, but is another key, so that no signature helps
//! with key agreement, or the other way round.

use std::fmt;
use std::sync::Arc;

use zeroize::Zeroizing;

use crate::crypto::{self, Backend, CryptoError, PUBLIC_KEY_LEN};

const CONTEXT: &[u8] = b"gdp/box-key/1";

/// A private P-256 key for key agreement. Clones share one copy, which is cleared with the last of them.
#[derive(Clone)]
pub struct BoxKey(Arc<Inner>);

struct Inner {
    secret: Zeroizing<[u8; 32]>,
    public: [u8; PUBLIC_KEY_LEN],
}

impl BoxKey {
    /// `HKDF-SHA256(signing key, info = "gdp/box-key/1" ‖ i)` with the lowest `i`, of one byte, for which that is a key: 0 but
    /// for one in 2³².
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
    pub(super) fn open(&self, info: &[u8], sealed: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        crypto::hpke_open(&self.0.secret, info, sealed)
    }

    /// The secret that this key and the private key of `peer` (SEC1 compressed) have in common.
    pub(super) fn agree(&self, peer: &[u8; PUBLIC_KEY_LEN]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
        Backend::default().agree(&self.0.secret, peer)
    }
}

impl fmt::Debug for BoxKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "BoxKey(public {})", hex::encode(self.0.public))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::{Identity, SigningKey};

    #[test]
    fn it_follows_from_the_identity_and_is_not_its_key() {
        let key = SigningKey::for_test(0x42);
        let (before, after) = (Identity::new(key.clone(), "proxy"), Identity::new(key.clone(), "proxy"));
        assert_eq!(before.box_public(), after.box_public());
        assert_ne!(before.box_public(), key.public());
        assert_ne!(before.box_public(), Identity::generate("proxy").unwrap().box_public());
    }

    #[test]
    fn both_sides_agree_and_nobody_else() {
        let [a, b, c] = [1, 2, 3].map(|seed| BoxKey::derive(&[seed; 32]).unwrap());
        assert_eq!(*a.agree(&b.public()).unwrap(), *b.agree(&a.public()).unwrap());
        assert_ne!(*a.agree(&b.public()).unwrap(), *a.agree(&c.public()).unwrap());
        assert_eq!(a.agree(&[0xff; PUBLIC_KEY_LEN]).err(), Some(CryptoError::BadPublicKey));
    }

    #[test]
    fn it_is_not_printed() {
        let key = BoxKey::derive(&[1; 32]).unwrap();
        let text = format!("{key:?}");
        assert!(!text.contains(&hex::encode(&key.0.secret[..4])), "{text}");
        assert_eq!(text, format!("BoxKey(public {})", hex::encode(key.public())));
    }
}
