//! The revocations that a node has heard of, kept in its state folder from one process to the next.

use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use gdp_wire::Name;
use parking_lot::Mutex;

use gdp_core::cert::{Revocation, Signed};
use gdp_core::name::NameProof;
use gdp_core::revocations::{RevocationFile, SignedRevocation};
use gdp_core::secret_file::SecretFileError;

/// Names that revocations are kept of.
const MOST: usize = 1024;

/// Bytes of the file.
const MAX_FILE: usize = 16 << 20;

/// What is kept, and where; without a folder, only as long as the node runs.
#[derive(Default)]
pub struct Revoked {
    /// Locked while it is written.
    file: Option<Mutex<RevocationFile>>,
    /// Those heard of last come last.
    entries: Mutex<Vec<(SignedRevocation, Revocation)>>,
    unsaved: AtomicBool,
    /// They could not be saved the last time, and the log says so.
    failing: AtomicBool,
}

impl Revoked {
    /// What an entity kept in a folder, which is made if it is not there.
    pub fn open(folder: Option<&Path>, entity: Name) -> Result<Self, SecretFileError> {
        let Some(folder) = folder else { return Ok(Self::default()) };
        let made = DirBuilder::new().recursive(true).mode(0o700).create(folder);
        made.map_err(|source| SecretFileError::Io { path: folder.into(), action: "make the folder", source })?;
        let file = RevocationFile::of_entity(folder, entity, MAX_FILE);
        let mut kept = file.load()?;
        kept.reverse();
        Ok(Self { file: Some(Mutex::new(file)), entries: Mutex::new(kept), ..Self::default() })
    }

    pub fn of(&self, name: &Name) -> Option<(Signed<Revocation>, Revocation)> {
        let kept = self.entries.lock();
        let (kept, claims) = kept.iter().find(|(_, claims)| claims.name == *name)?;
        Some((kept.revocation.clone(), claims.clone()))
    }

    /// Keeps one that was verified, unless a newer one of its name is kept.
    pub fn keep(&self, proof: NameProof, revocation: Signed<Revocation>, claims: Revocation) {
        let mut kept = self.entries.lock();
        if let Some(at) = kept.iter().position(|(_, held)| held.name == claims.name) {
            if kept[at].1.number >= claims.number {
                return;
            }
            kept.remove(at);
        } else if kept.len() >= MOST {
            kept.remove(0);
        }
        kept.push((SignedRevocation { proof, revocation, origin: None }, claims));
        self.unsaved.store(true, Ordering::Relaxed);
    }

    /// Writes what is new to the file; if it cannot, that is still to be done. Blocks, also until
    /// somebody else has written it.
    pub fn save(&self) {
        let Some(file) = &self.file else { return };
        let file = file.lock();
        if !self.unsaved.swap(false, Ordering::Relaxed) {
            return;
        }
        // The file has those first that count most.
        let kept: Vec<SignedRevocation> = self.entries.lock().iter().rev().map(|(kept, _)| kept.clone()).collect();
        let saved = file.save(&kept);
        let failed_before = self.failing.swap(saved.is_err(), Ordering::Relaxed);
        match saved {
            Ok(0) => {}
            Ok(omitted) => {
                let file = file.path().display();
                tracing::warn!(%file, omitted, "there is no room for the oldest revocations; they are forgotten when \
                                                this node ends");
            }
            Err(error) => {
                self.unsaved.store(true, Ordering::Relaxed);
                if !failed_before {
                    tracing::error!(%error, "revocations are forgotten when this node ends, unless they can be saved \
                                             before");
                }
            }
        }
    }

    pub fn is_unsaved(&self) -> bool {
        self.file.is_some() && self.unsaved.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/revoked.rs"]
mod tests;
