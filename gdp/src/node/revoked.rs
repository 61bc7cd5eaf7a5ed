//! The revocations that a node has heard of, kept in its state folder from one process to the next.

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
pub const MAX_FILE: usize = 16 << 20;

/// What is kept, and where; without a folder, only as long as the node runs.
#[derive(Default)]
pub struct Revoked {
    file: Option<RevocationFile>,
    /// Those heard of last come last.
    kept: Mutex<Vec<(Kept, Revocation)>>,
    unsaved: AtomicBool,
}

impl Revoked {
    pub fn open(file: Option<RevocationFile>) -> Result<Self, SecretFileError> {
        let mut kept = file.as_ref().map_or_else(|| Ok(Vec::new()), RevocationFile::load)?;
        kept.reverse();
        Ok(Self { file, kept: Mutex::new(kept), unsaved: AtomicBool::default() })
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

    /// Writes what is new to the file. Blocks.
    pub fn save(&self) {
        let Some(file) = &self.file else { return };
        if !self.unsaved.swap(false, Ordering::Relaxed) {
            return;
        }
        // The file has those first that count most.
        let kept: Vec<Kept> = lock(&self.kept).iter().rev().map(|(kept, _)| kept.clone()).collect();
        if let Err(error) = file.save(&kept) {
            tracing::error!(%error, "revocations are forgotten when this node ends");
        }
    }

    pub fn is_unsaved(&self) -> bool {
        self.file.is_some() && self.unsaved.load(Ordering::Relaxed)
    }
}
