//! The revocations of the RIB here, in a file beside the switch's key: so a daemon that starts anew refuses at once what an owner has
//! taken back. Nothing else of the RIB is kept; entities state it again.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gdp::control::{Refusal, RefusalCode};
use gdp::revocations::RevocationFile;
use gdp::secret_file::SecretFileError;
use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until};

use super::Daemon;
use super::core::Core;

/// Bytes of the file.
const MAX: usize = 16 << 20;

/// The file is written once in so long at most, however many revocations come.
const BETWEEN: Duration = Duration::from_millis(250);

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
    /// Returns once what has been revoked by now is in the file; to be called before it is said to be done. What could not be
    /// written is tried again by the next call.
    pub(super) async fn keep_revocations(self: &Arc<Self>) -> Result<(), Refusal> {
        let kept = &self.revocations;
        let wanted = self.core().rib.as_ref().map_or(0, |rib| rib.revocations_taken());
        let is_saved = || kept.saved.load(Ordering::Acquire) >= wanted;
        if is_saved() {
            return Ok(());
        }
        let mut next = kept.next.lock().await;
        // Who wrote meanwhile may have written this as well.
        if is_saved() {
            return Ok(());
        }
        sleep_until(*next).await;
        let (taken, all) = match &self.core().rib {
            Some(rib) => (rib.revocations_taken(), rib.kept_revocations()),
            None => return Ok(()),
        };
        let file = kept.file.clone();
        let saved = tokio::task::spawn_blocking(move || file.save(&all)).await;
        *next = Instant::now() + BETWEEN;
        let failed = match saved {
            Ok(Ok(omitted)) => {
                if omitted > 0 {
                    tracing::warn!(omitted, "more revocations than {} holds", kept.file.path().display());
                }
                kept.saved.store(taken, Ordering::Release);
                return Ok(());
            }
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        tracing::error!("revocations are forgotten when this daemon ends: {failed}");
        let reason = format!(
            "taken in, but not kept: {failed}; until that is mended and it is revoked again, it ends with the daemon of the RIB"
        );
        Err(Refusal::new(RefusalCode::Unreachable, reason))
    }
}
