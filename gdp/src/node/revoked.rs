//! The revocations that a node has received, stored in its state folder across restarts.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use gdp_wire::Name;
use parking_lot::Mutex;

use gdp_core::cert::{Revocation, Signed};
use gdp_core::name::NameProof;
use gdp_core::revocations::{RevocationFile, SignedRevocation};
use gdp_core::secret_file::SecretFileError;
use gdp_util::os;

/// Maximum number of names with a stored revocation.
const MOST: usize = 1024;

/// Maximum size of the file, in bytes.
const MAX_FILE: usize = 16 << 20;

/// The known revocations and their file. Without a folder, they last until the node ends.
#[derive(Default)]
pub struct Revoked {
    /// Locked during a write.
    file: Option<Mutex<RevocationFile>>,
    /// The most recently received last.
    entries: Mutex<Vec<(SignedRevocation, Revocation)>>,
    unsaved: AtomicBool,
    /// Whether the last attempt to save failed and was logged.
    failing: AtomicBool,
}

impl Revoked {
    /// Loads the revocations of an entity from a folder. Creates the folder if it does not exist.
    pub fn open(folder: Option<&Path>, entity: Name) -> Result<Self, SecretFileError> {
        let Some(folder) = folder else { return Ok(Self::default()) };
        os::create_private_folder(folder).map_err(|source| SecretFileError::Io {
            path: folder.into(),
            action: "make the folder",
            source,
        })?;
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

    /// Stores a verified revocation, unless a newer one of the same name is stored.
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

    /// Writes new revocations to the file. After a failure they stay marked as unsaved. Blocks,
    /// also while another task writes the file.
    pub fn save(&self) {
        let Some(file) = &self.file else { return };
        let file = file.lock();
        if !self.unsaved.swap(false, Ordering::Relaxed) {
            return;
        }
        // The most important revocations come first in the file.
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
