//! Unit tests of `keys::box_key`.

use super::*;
use crate::identity::{Identity, SigningKey};

#[test]
fn it_follows_from_the_identity_and_is_not_its_key() {
    let key = SigningKey::from_secret_bytes(&[0x42; 32]).unwrap();
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
