//! The revocations of the RIB here, in a file beside the switch's key: so a daemon that starts anew refuses at once what an owner has
//! taken back. Nothing else of the RIB is kept; entities state it again.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gdp::revocations::RevocationFile;
use gdp::secret_file::SecretFileError;
use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until};

use super::Daemon;
use super::core::Core;

/// Bytes of the file.
const MAX: usize = 16 << 20;

/// The file is written once in so long at most, however many revocations come.
const BETWEEN: Duration = Duration::from_millis(50);

pub struct KeptRevocations {
    file: RevocationFile,
    /// What the file holds, as [`crate::rib::Rib::revocations_taken`] counts.
    saved: AtomicU64,
    /// Held by who writes: when that is allowed again.
    next: Mutex<Instant>,
}

impl KeptRevocations {
    /// Gives the RIB what an earlier one knew.
    pub fn recall(identity: &Path, core: &mut Core) -> Result<Self, SecretFileError> {
        let file = RevocationFile::new(identity.with_extension("revocations"), MAX);
        let mut saved = 0;
        if let Some(rib) = &mut core.rib {
            rib.recall(file.load()?);
            saved = rib.revocations_taken();
        }
        Ok(Self { file, saved: saved.into(), next: Mutex::new(Instant::now()) })
    }
}

impl Daemon {
    /// Returns once what has been revoked by now is in the file; to be called before it is said to be done.
    pub(super) async fn keep_revocations(self: &Arc<Self>) {
        let kept = &self.revocations;
        let taken = self.core().rib.as_ref().map_or(0, |rib| rib.revocations_taken());
        if taken <= kept.saved.load(Ordering::Acquire) {
            return;
        }
        let mut next = kept.next.lock().await;
        sleep_until(*next).await;
        let (taken, all) = match &self.core().rib {
            Some(rib) if rib.revocations_taken() > kept.saved.load(Ordering::Acquire) => {
                (rib.revocations_taken(), rib.kept_revocations())
            }
            _ => return,
        };
        let file = kept.file.clone();
        let saved = tokio::task::spawn_blocking(move || file.save(&all)).await;
        match saved {
            Ok(Ok(0)) => {}
            Ok(Ok(omitted)) => tracing::warn!(omitted, "more revocations than {} holds", kept.file.path().display()),
            Ok(Err(error)) => tracing::error!(%error, "revocations are forgotten when this daemon ends"),
            Err(error) => tracing::error!(%error, "revocations could not be kept"),
        }
        // What failed is tried again with the next one.
        kept.saved.store(taken, Ordering::Release);
        *next = Instant::now() + BETWEEN;
    }
}
