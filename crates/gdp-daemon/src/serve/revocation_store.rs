//! What outlives a daemon though the RIB and the links do not: a file is written before it is said
//! that something is done, and not for each of many changes by itself. The revocations of the RIB
//! here are kept so, in a file beside the switch's key: a daemon that starts anew refuses at once
//! what an owner has taken back. Nothing else of the RIB is kept; entities state it again. What is
//! stored of the domain is in [`super::domain_store`].

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

/// Bytes of the file.
const MAX: usize = 16 << 20;

/// Files are written once in so long at most, however many changes come.
const BETWEEN: Duration = Duration::from_millis(250);

/// How far something that counts its changes is written.
pub struct RevocationStore {
    saved: Arc<AtomicU64>,
    /// Held while a file is written, also by who waits for that no more: when the next one may be.
    next: Arc<Mutex<Instant>>,
}

impl RevocationStore {
    /// So many changes are in the file.
    pub fn new(saved: u64) -> Self {
        Self { saved: Arc::new(saved.into()), next: Arc::new(Mutex::new(Instant::now())) }
    }

    /// Returns once so many changes are in the file. `collect`: all there is to write, and how many
    /// changes that is; `write` blocks. What could not be written is tried again by the next call.
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
        // Who wrote meanwhile may have written this as well.
        if is_saved() {
            return Ok(());
        }
        sleep_until(*next).await;
        let Some((collected, all)) = collect() else { return Ok(()) };
        let saved = self.saved.clone();
        let writing = move || {
            let written = write(all);
            // Before the next one looks, and though nobody may wait for this any more.
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
    /// Of what [`gdp_rib::rib::Rib::revocations_taken`] counts.
    progress: RevocationStore,
}

impl StoredRevocations {
    /// Gives the RIB what an earlier one knew.
    pub fn recall(identity: &Path, rib: Option<&mut Rib>) -> Result<Self, SecretFileError> {
        let file = RevocationFile::new(identity.with_extension("revocations"), MAX);
        let mut saved = 0;
        if let Some(rib) = rib {
            rib.recall(file.load()?);
            saved = rib.revocations_taken();
        }
        Ok(Self { file, progress: RevocationStore::new(saved) })
    }

    /// What an earlier RIB here knew.
    pub fn known(&self) -> Result<Vec<(SignedRevocation, Revocation)>, SecretFileError> {
        self.file.load()
    }

    /// There is another RIB, that has taken so many from the file.
    pub fn restart(&self, taken: u64) {
        self.progress.saved.store(taken, Ordering::Release);
    }

    /// Returns once so many changes are in the file. `collect`: how many there are, and all there
    /// is to write.
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
