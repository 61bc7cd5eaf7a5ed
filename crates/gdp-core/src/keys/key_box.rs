//! Key box: an epoch key, wrapped for one reader and signed by the writer. It is stored beside the
//! writer's advertisement, so that the reader receives it while the writer is away. Its storer
//! learns which reader may read which writer, but no key.

use serde::{Deserialize, Serialize};

use super::BoxKey;
use crate::cert::{CertError, Claims, Signed, Validity, issue};
use crate::crypto;
use crate::crypto::{CryptoError, HPKE_OVERHEAD, PUBLIC_KEY_LEN};
use crate::identity::Identity;
use crate::keys::EpochKey;
use crate::name::Name;
use crate::verify_key::VerifyKey;

const CONTEXT: &[u8] = b"gdp/key-box/1";
const SEALED_LEN: usize = 32 + HPKE_OVERHEAD;

/// Key of the writer's epoch for the name, wrapped for the reader. It is valid until the writer
/// starts another epoch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyBox {
    pub name: Name,
    pub writer: Name,
    pub reader: Name,
    /// Epoch number, which increases with every epoch of the writer for the name.
    pub epoch: u32,
    /// Epoch key, 32 bytes, encrypted to the reader's box key ([`crypto::hpke_seal`]).
    #[serde(with = "crate::cbor::bytes")]
    pub sealed: Vec<u8>,
}

impl Claims for KeyBox {
    const KIND: &'static str = "KeyBox";
    const LABEL: &'static str = "GDP KEY BOX";
    const CONTEXT: &'static str = "application/vnd.gdp.key-box.v2+cbor";

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
    /// Returns the HPKE `info`, which binds the box to its name, writer, reader and epoch.
    pub fn info(&self) -> Vec<u8> {
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

/// Opens a box for `reader` and returns its epoch and key. Verifies the signature by `writer_key`
/// and that the box is for `name`.
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
#[path = "../../tests/unit/keys/key_box.rs"]
mod tests;
