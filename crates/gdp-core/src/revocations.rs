//! Revocations that outlive a process: a file of the newest that were verified, written whole and
//! read back with suspicion. So what an owner took back stays so for a node or a RIB that starts
//! anew, also before anybody tells it again.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::cbor::CborError;
use crate::cert::{CertError, Revocation, Signed};
use crate::name::{Name, NameProof};
use crate::secret_file::SecretFileError;
use crate::{cbor, secret_file};

/// The first bytes of such a file.
const HEAD: &[u8] = b"gdp revocations 1\n";

/// Bytes of one entry: a revocation of as many serials as there may be, and a proof.
const MAX_ENTRY: usize = 32 << 10;

/// A revocation, and how the name it is about shows its owner's key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedRevocation {
    pub proof: NameProof,
    pub revocation: Signed<Revocation>,
    /// Where it came in, if a RIB keeps it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
}

/// Where a RIB took something in: through a switch, from a tool there or from an entity; or from
/// the RIB of a neighbouring domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// The switch, or the neighbouring domain.
    pub through: Name,
    pub by_tool: bool,
}

impl SignedRevocation {
    /// What the owner of the name has taken back.
    pub fn verify(&self) -> Result<Revocation, CertError> {
        let (name, key) = (self.proof.name()?, self.proof.verify_key()?);
        let claims = self.revocation.verify(&key, 0)?;
        if claims.name != name {
            return Err(CertError::WrongName { expected: name, got: claims.name });
        }
        Ok(claims)
    }
}

/// Where revocations are kept: at mode 0600, and at most so many bytes.
#[derive(Clone, Debug)]
pub struct RevocationFile {
    path: PathBuf,
    max: usize,
}

impl RevocationFile {
    /// At `path`, and of `max` bytes.
    pub fn new(path: PathBuf, max: usize) -> Self {
        Self { path, max }
    }

    /// In a folder for what an entity keeps.
    pub fn of_entity(folder: &Path, entity: Name, max: usize) -> Self {
        Self::new(folder.join(format!("{entity}.revocations")), max)
    }

    /// Where it is, if anything was kept.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All that were kept and still verify, in the order in which they were; none if there is no
    /// file.
    pub fn load(&self) -> Result<Vec<(SignedRevocation, Revocation)>, SecretFileError> {
        let bytes = match secret_file::read(&self.path, self.max) {
            Err(error) if error.is_not_found() => return Ok(Vec::new()),
            bytes => bytes?,
        };
        let mut loaded = Vec::new();
        for entry in self.entries(&bytes)? {
            match entry.verify() {
                Ok(claims) => loaded.push((entry, claims)),
                Err(error) => {
                    tracing::warn!(file = %self.path.display(), %error, "a kept revocation does not verify and is left out");
                }
            }
        }
        Ok(loaded)
    }

    /// Keeps these instead of what is there, as many of them as there is room for. Returns how many
    /// there was none for.
    pub fn save<'a>(&self, kept: impl IntoIterator<Item = &'a SignedRevocation>) -> Result<usize, SecretFileError> {
        let (mut bytes, mut omitted) = (HEAD.to_vec(), 0);
        for entry in kept {
            let encoded = cbor::encode(entry).map_err(|error| self.malformed(&error))?;
            if bytes.len() + 4 + encoded.len() > self.max {
                omitted += 1;
                continue;
            }
            bytes.extend_from_slice(&(encoded.len() as u32).to_be_bytes());
            bytes.extend_from_slice(&encoded);
        }
        secret_file::replace(&self.path, &bytes)?;
        Ok(omitted)
    }

    fn entries(&self, bytes: &[u8]) -> Result<Vec<SignedRevocation>, SecretFileError> {
        let damaged = || self.malformed(&"not a whole file of revocations; remove it to begin without");
        let mut rest = bytes.strip_prefix(HEAD).ok_or_else(damaged)?;
        let mut entries = Vec::new();
        while !rest.is_empty() {
            let (length, behind) = rest.split_first_chunk().ok_or_else(damaged)?;
            let (entry, behind) = behind.split_at_checked(u32::from_be_bytes(*length) as usize).ok_or_else(damaged)?;
            let entry = cbor::decode(entry, MAX_ENTRY).map_err(|error: CborError| self.malformed(&error))?;
            entries.push(entry);
            rest = behind;
        }
        Ok(entries)
    }

    fn malformed(&self, reason: &dyn std::fmt::Display) -> SecretFileError {
        SecretFileError::malformed(&self.path, reason)
    }
}

#[cfg(test)]
#[path = "../tests/unit/revocations.rs"]
mod tests;
