//! Unit tests of `keys::key_box`.

use super::*;
use crate::identity::SigningKey;

const NAME: Name = Name::from_bytes([1; 32]);
const OTHER: Name = Name::from_bytes([2; 32]);

#[test]
fn the_reader_opens_it_and_nobody_else() {
    let (writer, reader, key) = (identity(1), identity(2), EpochKey::from_bytes([9; 32]));
    let signed = wrap(NAME, &writer, (reader.name(), &reader.box_public()), 7, &key).unwrap();
    let (verify_key, for_reader) = (writer.key().verify_key(), (reader.name(), reader.box_key()));
    let from_writer = (writer.name(), &verify_key);
    let (epoch, opened) = open(&signed, NAME, from_writer, for_reader).unwrap();
    assert_eq!((epoch, opened.as_bytes()), (7, key.as_bytes()));

    let error = open(&signed, OTHER, from_writer, for_reader).unwrap_err();
    assert_eq!(error, CertError::WrongName { expected: OTHER, got: NAME });
    let error = open(&signed, NAME, (OTHER, &verify_key), for_reader).unwrap_err();
    assert_eq!(error, CertError::WrongEntity { expected: OTHER, got: writer.name() });
    let error = open(&signed, NAME, from_writer, (OTHER, reader.box_key())).unwrap_err();
    assert_eq!(error, CertError::WrongEntity { expected: OTHER, got: reader.name() });
    let error = open(&signed, NAME, from_writer, (reader.name(), identity(3).box_key())).unwrap_err();
    assert_eq!(error, CertError::Crypto(CryptoError::Forged));
    let stranger = identity(3).key().verify_key();
    let error = open(&signed, NAME, (writer.name(), &stranger), for_reader).unwrap_err();
    assert!(matches!(error, CertError::WrongKey { what: "KeyBox", .. }), "{error}");
}

/// A writer that signs what it took from another's box, or from one of its own, gives nobody a key.
#[test]
fn a_sealed_key_moved_to_another_box_does_not_open() {
    let (writer, reader) = (identity(1), identity(2));
    let signed = wrap(NAME, &writer, (reader.name(), &reader.box_public()), 7, &EpochKey::from_bytes([9; 32]));
    let claims = signed.unwrap().claims_unverified().unwrap();
    let moved = [
        KeyBox { name: OTHER, ..claims.clone() },
        KeyBox { writer: OTHER, ..claims.clone() },
        KeyBox { reader: OTHER, ..claims.clone() },
        KeyBox { epoch: 8, ..claims },
    ];
    for claims in moved {
        let signed = issue(writer.key(), &claims).unwrap();
        let verify_key = writer.key().verify_key();
        let result = open(&signed, claims.name, (claims.writer, &verify_key), (claims.reader, reader.box_key()));
        assert_eq!(result.err(), Some(CertError::Crypto(CryptoError::Forged)), "{claims:?}");
    }
}

#[test]
fn hostile_boxes_are_refused() {
    let (writer, reader) = (identity(1), identity(2));
    let signed = wrap(NAME, &writer, (reader.name(), &reader.box_public()), 7, &EpochKey::from_bytes([9; 32])).unwrap();
    let verify_key = writer.key().verify_key();
    let open = |bytes: Vec<u8>| {
        let signed = Signed::from_bytes(bytes)?;
        open(&signed, NAME, (writer.name(), &verify_key), (reader.name(), reader.box_key()))
    };
    for at in 0..signed.as_bytes().len() {
        let mut changed = signed.as_bytes().to_vec();
        changed[at] ^= 0x11;
        assert!(open(changed).is_err(), "byte {at}");
        assert!(open(signed.as_bytes()[..at].to_vec()).is_err(), "cut to {at}");
    }
    let claims = signed.claims_unverified().unwrap();
    for len in [0, 64, SEALED_LEN - 1, SEALED_LEN + 1, 3000] {
        let error = issue(writer.key(), &KeyBox { sealed: vec![4; len], ..claims.clone() }).unwrap_err();
        assert!(matches!(error, CertError::Malformed(_)), "{error}");
    }
    // Not a point, and the point at infinity.
    for sealed in [vec![0; SEALED_LEN], vec![4; SEALED_LEN]] {
        let signed = issue(writer.key(), &KeyBox { sealed, ..claims.clone() }).unwrap();
        assert_eq!(open(signed.as_bytes().to_vec()).err(), Some(CertError::Crypto(CryptoError::Forged)));
    }
}

fn identity(seed: u8) -> Identity {
    Identity::new(SigningKey::from_secret_bytes(&[seed; 32]).unwrap(), "proxy")
}
