//! The secret that the writers and readers of a name share for an epoch. Sessions derive their own keys from it.

use super::wire;
use crate::crypto::{self, Aead, Backend, CryptoError};
use crate::name::Name;
use crate::secret_file::{self, SecretFileError};
use std::fmt;
use std::path::Path;
use zeroize::Zeroizing;

/// 64 hex digits and some white space.
const MAX_FILE: usize = 256;

#[derive(Clone)]
pub struct EpochKey(Zeroizing<[u8; 32]>);

impl EpochKey {
    pub fn generate() -> Result<Self, CryptoError> {
        Ok(Self(Zeroizing::new(crypto::random()?)))
    }

    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(Zeroizing::new(bytes))
    }

    /// `None` if these are not 32 bytes.
    pub(crate) fn from_slice(bytes: &[u8]) -> Option<Self> {
        let mut key = Zeroizing::new([0u8; 32]);
        if bytes.len() != key.len() {
            return None;
        }
        key.copy_from_slice(bytes);
        Some(Self(key))
    }

    /// For wrapping it, and for nothing else.
    pub(crate) fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Reads a file of 64 hex digits. One that others may read or write is refused.
    pub fn load(path: &Path) -> Result<Self, SecretFileError> {
        let content = secret_file::read(path, MAX_FILE)?;
        let mut key = Zeroizing::new([0u8; 32]);
        hex::decode_to_slice(content.trim_ascii(), key.as_mut_slice()).map_err(|_| {
            SecretFileError::malformed(path, "not an epoch key: 64 hex digits are expected (`openssl rand -hex 32`)")
        })?;
        Ok(Self(key))
    }

    /// Writes a new file of mode 0600. An existing file is never overwritten.
    pub fn save_new(&self, path: &Path) -> Result<(), SecretFileError> {
        let mut text = Zeroizing::new([b'\n'; 65]);
        hex::encode_to_slice(self.0.as_slice(), &mut text[..64]).map_err(|e| SecretFileError::malformed(path, e))?;
        secret_file::create(path, text.as_slice())
    }

    /// `HKDF-SHA256(epoch key, salt = session, info = "gdp/session/1" ‖ name ‖ writer)`.
    pub(super) fn session_aead(
        &self,
        backend: Backend,
        name: &Name,
        writer: &Name,
        session: &[u8; 16],
    ) -> Result<Aead, CryptoError> {
        let info: [&[u8]; 3] = [wire::SESSION_CONTEXT, name.as_bytes(), writer.as_bytes()];
        backend.aead(&*backend.hkdf_sha256(session, self.0.as_slice(), &info)?)
    }
}

impl fmt::Debug for EpochKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("EpochKey(…)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_key_survives_its_file_and_is_not_printed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("epoch.key");
        let key = EpochKey::generate().unwrap();
        key.save_new(&path).unwrap();
        assert_eq!(EpochKey::load(&path).unwrap().0, key.0);
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text.len(), 65);
        assert!(!format!("{key:?}").contains(&text[..8]));
        assert!(key.save_new(&path).is_err());
        for broken in ["", "0123", &"g".repeat(64), &"0".repeat(66)] {
            fs::write(&path, broken).unwrap();
            let error = EpochKey::load(&path).unwrap_err().to_string();
            assert!(error.contains("epoch.key") && error.contains("64 hex digits"), "{error}");
        }
    }
}
