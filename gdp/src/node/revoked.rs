//! The revocations that a node has heard of, kept in its state folder from one process to the next.

use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use gdp_wire::Name;

use super::state::lock;
use crate::cert::{Revocation, Signed};
use crate::name::NameProof;
use crate::revocations::{Kept, RevocationFile};
use crate::secret_file::SecretFileError;

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
    kept: Mutex<Vec<(Kept, Revocation)>>,
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
        Ok(Self { file: Some(Mutex::new(file)), kept: Mutex::new(kept), ..Self::default() })
    }

    pub fn of(&self, name: &Name) -> Option<(Signed<Revocation>, Revocation)> {
        let kept = lock(&self.kept);
        let (kept, claims) = kept.iter().find(|(_, claims)| claims.name == *name)?;
        Some((kept.revocation.clone(), claims.clone()))
    }

    /// Keeps one that was verified, unless a newer one of its name is kept.
    pub fn keep(&self, proof: NameProof, revocation: Signed<Revocation>, claims: Revocation) {
        let mut kept = lock(&self.kept);
        if let Some(at) = kept.iter().position(|(_, held)| held.name == claims.name) {
            if kept[at].1.number >= claims.number {
                return;
            }
            kept.remove(at);
        } else if kept.len() >= MOST {
            kept.remove(0);
        }
        kept.push((Kept { proof, revocation, origin: None }, claims));
        self.unsaved.store(true, Ordering::Relaxed);
    }

    /// Writes what is new to the file; if it cannot, that is still to be done. Blocks, also until somebody else has written it.
    pub fn save(&self) {
        let Some(file) = &self.file else { return };
        let file = lock(file);
        if !self.unsaved.swap(false, Ordering::Relaxed) {
            return;
        }
        // The file has those first that count most.
        let kept: Vec<Kept> = lock(&self.kept).iter().rev().map(|(kept, _)| kept.clone()).collect();
        let saved = file.save(&kept);
        let failed_before = self.failing.swap(saved.is_err(), Ordering::Relaxed);
        match saved {
            Ok(0) => {}
            Ok(omitted) => {
                let file = file.path().display();
                tracing::warn!(%file, omitted, "there is no room for the oldest revocations; they are forgotten when this node ends");
            }
            Err(error) => {
                self.unsaved.store(true, Ordering::Relaxed);
                if !failed_before {
                    tracing::error!(%error, "revocations are forgotten when this node ends, unless they can be saved before");
                }
            }
        }
    }

    pub fn is_unsaved(&self) -> bool {
        self.file.is_some() && self.unsaved.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;
    use crate::cert::issue;
    use crate::identity::SigningKey;

    fn revocation() -> (NameProof, Signed<Revocation>, Revocation) {
        let owner = SigningKey::generate().unwrap();
        let proof = NameProof { owner_key: owner.public(), digest: [1; 32] };
        let claims = Revocation { name: proof.name().unwrap(), number: 1, floor: 0, revoked: vec![1] };
        (proof, issue(&owner, &claims).unwrap(), claims)
    }

    #[test]
    fn what_could_not_be_saved_is_saved_later() {
        let (parent, entity) = (tempfile::tempdir().unwrap(), Name::from_bytes([7; 32]));
        let folder = parent.path().join("made/for/it");
        let revoked = Revoked::open(Some(&folder), entity).unwrap();
        let (proof, signed, claims) = revocation();
        revoked.keep(proof, signed, claims.clone());
        std::fs::remove_dir(&folder).unwrap();
        revoked.save();
        assert!(revoked.is_unsaved());
        std::fs::create_dir(&folder).unwrap();
        revoked.save();
        assert!(!revoked.is_unsaved());
        let again = Revoked::open(Some(&folder), entity).unwrap();
        assert_eq!(again.of(&claims.name).unwrap().1, claims);
    }

    #[test]
    fn whoever_saves_finds_it_saved_afterwards() {
        let (proof, signed, claims) = revocation();
        for _ in 0..20 {
            let folder = tempfile::tempdir().unwrap();
            let revoked = Revoked::open(Some(folder.path()), Name::default()).unwrap();
            revoked.keep(proof, signed.clone(), claims.clone());
            std::thread::scope(|threads| {
                threads.spawn(|| revoked.save());
                let deadline = Instant::now() + Duration::from_secs(60);
                while revoked.is_unsaved() {
                    assert!(Instant::now() < deadline, "it is not saved");
                    std::thread::yield_now();
                }
                // The other one is at it now.
                revoked.save();
                assert!(Revoked::open(Some(folder.path()), Name::default()).unwrap().of(&claims.name).is_some());
            });
        }
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_told_of() {
        let parent = tempfile::tempdir().unwrap();
        let file = parent.path().join("file");
        std::fs::write(&file, "").unwrap();
        let error = Revoked::open(Some(&file.join("folder")), Name::default()).err().unwrap().to_string();
        assert!(error.contains("file/folder: cannot make the folder"), "{error}");
    }
}
