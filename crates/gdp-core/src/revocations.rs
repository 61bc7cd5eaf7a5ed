//! Revocations that outlive a process. The file holds the newest verified ones. It is written as a
//! whole, and its content is verified again when read. A revocation thus stays in force for a
//! restarted node or RIB, even before it is announced again.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::cbor::CborError;
use crate::cert::{CertError, Revocation, Signed};
use crate::name::{Name, NameProof};
use crate::secret_file::SecretFileError;
use crate::{cbor, secret_file};

/// First bytes of the file.
const HEAD: &[u8] = b"gdp revocations 1\n";

/// Maximum bytes of one entry: a revocation with the maximum number of serials, and a proof.
const MAX_ENTRY: usize = 32 << 10;

/// Signed revocation with the proof of its name, which holds the owner's key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedRevocation {
    pub proof: NameProof,
    pub revocation: Signed<Revocation>,
    /// Origin of the revocation, if a RIB stores it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
}

/// Origin of a revocation at a RIB. It is an entity or a tool at a switch, or the RIB of a
/// neighbouring domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Name of the switch or of the neighbouring domain.
    pub through: Name,
    pub by_tool: bool,
}

impl SignedRevocation {
    /// Verifies the owner's signature and returns the claims.
    pub fn verify(&self) -> Result<Revocation, CertError> {
        self.revocation.verify_revocation(&self.proof)
    }
}

/// File of revocations with mode 0600 and a maximum size in bytes.
#[derive(Clone, Debug)]
pub struct RevocationFile {
    path: PathBuf,
    max: usize,
}

impl RevocationFile {
    /// Creates a handle for the file at `path` of at most `max` bytes.
    pub fn new(path: PathBuf, max: usize) -> Self {
        Self { path, max }
    }

    /// Creates a handle for an entity's file in a folder.
    pub fn of_entity(folder: &Path, entity: Name, max: usize) -> Self {
        Self::new(folder.join(format!("{entity}.revocations")), max)
    }

    /// Returns the path, whether the file exists or not.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the stored revocations that still verify, in their order. Returns none if there is
    /// no file.
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

    /// Replaces the content of the file by as many of these as fit. Returns the number of those
    /// that did not fit.
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
