//! The key of an epoch, wrapped for one reader and signed by the writer: kept beside the writer's advertisement, so that the
//! reader gets it while the writer is away. Whoever keeps it learns who may read whom, and no key.

use serde::{Deserialize, Serialize};

use super::BoxKey;
use crate::cert::{CertError, Claims, Signed, Validity, issue};
use crate::crypto::{self, CryptoError, HPKE_OVERHEAD, PUBLIC_KEY_LEN};
use crate::identity::{Identity, VerifyKey};
use crate::name::Name;
use crate::seal::EpochKey;

const CONTEXT: &[u8] = b"gdp/key-box/1";
const SEALED_LEN: usize = 32 + HPKE_OVERHEAD;

/// Writer → reader: the key of this epoch of the name. It holds until the writer makes another.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeyBox {
    pub name: Name,
    pub writer: Name,
    pub reader: Name,
    /// Rises with every epoch of the writer for the name.
    pub epoch: u32,
    /// The epoch key, 32 bytes, sealed for the reader's box key ([`crypto::hpke_seal`]).
    #[serde(with = "crate::cbor::bytes")]
    pub sealed: Vec<u8>,
}

impl Claims for KeyBox {
    const KIND: &'static str = "KeyBox";
    const LABEL: &'static str = "GDP KEY BOX";
    const CONTEXT: &'static str = "application/vnd.gdp.key-box.v1+cbor";

    fn validity(&self) -> Validity {
        Validity::ALWAYS
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        match self.sealed.len() {
            SEALED_LEN => Ok(()),
            len => Err(CertError::Malformed(format!("a sealed key of {len} bytes where {SEALED_LEN} are expected"))),
        }
    }
}

impl KeyBox {
    /// By which no box opens as one of another name, writer, reader or epoch.
    pub(super) fn info(&self) -> Vec<u8> {
        let names = [self.name, self.writer, self.reader].map(|name| *name.as_bytes());
        [CONTEXT, names.as_flattened(), &self.epoch.to_be_bytes()].concat()
    }
}

/// Wraps the key of `writer`'s epoch for `reader`, whose box key is `box_key`.
pub fn wrap(
    name: Name,
    writer: &Identity,
    reader: (Name, &[u8; PUBLIC_KEY_LEN]),
    epoch: u32,
    key: &EpochKey,
) -> Result<Signed<KeyBox>, CertError> {
    let (reader, box_key) = reader;
    let mut claims = KeyBox { name, writer: writer.name(), reader, epoch, sealed: Vec::new() };
    claims.sealed = crypto::hpke_seal(box_key, &claims.info(), key.as_bytes())?;
    issue(writer.key(), &claims)
}

/// The epoch and key in a box for `reader` that `writer`, whose key is `writer_key`, made for `name`.
pub fn open(
    signed: &Signed<KeyBox>,
    name: Name,
    writer: (Name, &VerifyKey),
    reader: (Name, &BoxKey),
) -> Result<(u32, EpochKey), CertError> {
    let (writer, writer_key) = writer;
    let (reader, box_key) = reader;
    let claims = signed.verify_signature(writer_key)?;
    if claims.name != name {
        return Err(CertError::WrongName { expected: name, got: claims.name });
    }
    for (expected, got) in [(writer, claims.writer), (reader, claims.reader)] {
        if expected != got {
            return Err(CertError::WrongEntity { expected, got });
        }
    }
    let opened = box_key.open(&claims.info(), &claims.sealed)?;
    let key = EpochKey::from_slice(&opened).ok_or(CryptoError::Forged)?;
    Ok((claims.epoch, key))
}

#[cfg(test)]
mod tests {
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
        let signed =
            wrap(NAME, &writer, (reader.name(), &reader.box_public()), 7, &EpochKey::from_bytes([9; 32])).unwrap();
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
        Identity::new(SigningKey::for_test(seed), "proxy")
    }
}
