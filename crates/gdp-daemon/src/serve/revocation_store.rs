//! Files that survive the daemon, unlike the RIB and the links.
//!
//! A file is written before a change is confirmed. Several changes share one write. The revocations
//! of the local RIB are stored this way, in a file beside the switch's key. After a restart, the
//! daemon thus refuses revoked rights at once. Nothing else of the RIB is stored; entities state it
//! again. [`super::domain_store`] stores the state of the domain.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gdp_core::cert::Revocation;
use gdp_core::revocations::{RevocationFile, SignedRevocation};
use gdp_core::secret_file::SecretFileError;
use gdp_proto::control::{Refusal, RefusalCode};
use gdp_rib::rib::Rib;
use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until};

/// The maximum size of the file, in bytes.
const MAX: usize = 16 << 20;

/// The minimum time between two writes of a file.
const BETWEEN: Duration = Duration::from_millis(250);

/// The number of changes that are saved in a file.
pub struct RevocationStore {
    saved: Arc<AtomicU64>,
    /// The earliest time of the next write. A running write holds the lock, even if no caller waits
    /// for it any more.
    next: Arc<Mutex<Instant>>,
}

impl RevocationStore {
    /// Creates the store. `saved` is the number of changes already in the file.
    pub fn new(saved: u64) -> Self {
        Self { saved: Arc::new(saved.into()), next: Arc::new(Mutex::new(Instant::now())) }
    }

    /// Waits until `changes` changes are in the file. `collect` returns the number of changes and
    /// the state to write. `write` may block. The next call retries a failed write.
    pub async fn keep<T: Send + 'static>(
        &self,
        changes: u64,
        collect: impl FnOnce() -> Option<(u64, T)>,
        write: impl FnOnce(T) -> Result<(), SecretFileError> + Send + 'static,
    ) -> Result<(), Refusal> {
        let is_saved = || self.saved.load(Ordering::Acquire) >= changes;
        if is_saved() {
            return Ok(());
        }
        let mut next = self.next.clone().lock_owned().await;
        // The previous writer may have saved this change as well.
        if is_saved() {
            return Ok(());
        }
        sleep_until(*next).await;
        let Some((collected, all)) = collect() else { return Ok(()) };
        let saved = self.saved.clone();
        let writing = move || {
            let written = write(all);
            // Store this before the next writer looks, even if no caller waits any more.
            if written.is_ok() {
                saved.store(collected, Ordering::Release);
            }
            *next = Instant::now() + BETWEEN;
            written
        };
        let written = tokio::task::spawn_blocking(writing).await;
        let failed = match written {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        tracing::error!("what was taken in is forgotten when this daemon ends: {failed}");
        let reason = format!(
            "taken in, but not kept: {failed}; until that is mended and it is asked for again, it ends with the \
             daemon that was to keep it"
        );
        Err(Refusal::new(RefusalCode::Unreachable, reason))
    }
}

pub struct StoredRevocations {
    file: RevocationFile,
    /// How many changes, as counted by [`gdp_rib::rib::Rib::revocations_taken`], are saved.
    progress: RevocationStore,
}

impl StoredRevocations {
    /// Loads the stored revocations into the RIB, if it is here.
    pub fn recall(identity: &Path, rib: Option<&mut Rib>) -> Result<Self, SecretFileError> {
        let file = RevocationFile::new(identity.with_extension("revocations"), MAX);
        let mut saved = 0;
        if let Some(rib) = rib {
            rib.recall(file.load()?);
            saved = rib.revocations_taken();
        }
        Ok(Self { file, progress: RevocationStore::new(saved) })
    }

    /// Returns the revocations that an earlier RIB stored here.
    pub fn known(&self) -> Result<Vec<(SignedRevocation, Revocation)>, SecretFileError> {
        self.file.load()
    }

    /// Resets the count of saved changes for a new RIB, which has loaded `taken` revocations from
    /// the file.
    pub fn restart(&self, taken: u64) {
        self.progress.saved.store(taken, Ordering::Release);
    }

    /// Waits until `changes` changes are in the file. `collect` returns the number of changes and
    /// the revocations to write.
    pub async fn save(
        &self,
        changes: u64,
        collect: impl FnOnce() -> Option<(u64, Vec<SignedRevocation>)>,
    ) -> Result<(), Refusal> {
        let file = self.file.clone();
        let write = move |all: Vec<SignedRevocation>| {
            let omitted = file.save(&all)?;
            if omitted > 0 {
                tracing::warn!(omitted, "more revocations than {} holds", file.path().display());
            }
            Ok(())
        };
        self.progress.keep(changes, collect, write).await
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/revocation_store.rs"]
mod tests;
