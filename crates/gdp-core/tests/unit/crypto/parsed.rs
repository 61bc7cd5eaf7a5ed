//! Unit tests of `crypto::parsed`.

use super::*;
use crate::identity::SigningKey;

#[test]
fn however_many_keys_come_each_verifies_what_it_signed_and_nothing_else() {
    let keys: Vec<SigningKey> = (0..2 * CACHED + 3).map(|_| SigningKey::generate().unwrap()).collect();
    let signatures: Vec<_> = keys.iter().map(|key| key.sign(b"message").unwrap()).collect();
    for round in 0..3 {
        for (i, key) in keys.iter().enumerate() {
            let verifier = parsed(&key.public()).unwrap();
            assert_eq!(verifier.verify(b"message", &signatures[i]), Ok(()), "{round}");
            let other = &signatures[(i + 1) % keys.len()];
            assert_eq!(verifier.verify(b"message", other), Err(CryptoError::BadSignature));
        }
        KEY_CACHE.with_borrow(|lately| assert_eq!(lately.keys.len(), CACHED));
        assert!(matches!(parsed(&[9; PUBLIC_KEY_LEN]), Err(CryptoError::BadPublicKey)));
    }
}
