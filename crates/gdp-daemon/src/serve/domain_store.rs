//! The stored state of a daemon's domain, which survives restarts.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use gdp_core::domain::PaperFileError;
use gdp_core::identity::Identity;
use gdp_core::revocations::{RevocationFile, SignedRevocation};
use gdp_core::secret_file::SecretFileError;
use gdp_core::{cbor, secret_file};
use gdp_proto::control::Refusal;
use gdp_util::date::relative;
use gdp_util::unix_time::unix_seconds;

use super::revocation_store::RevocationStore;
use crate::config::DomainConfig;
use crate::domain::{Domain, DomainError, Invitations, MAX_USED, Trust, Used};

/// The maximum size of the revocations of all known domains, in bytes.
const MAX_REVOCATIONS: usize = 256 << 10;

/// The maximum size of the used invitations, in bytes.
const MAX_INVITATIONS: usize = 128 * MAX_USED;

/// The reason why a daemon cannot be a member of its domain.
#[derive(Debug, thiserror::Error)]
pub enum MembershipError {
    #[error(transparent)]
    File(#[from] PaperFileError),
    #[error("domain: {0}")]
    Domain(#[from] DomainError),
    #[error(transparent)]
    Stored(#[from] SecretFileError),
}

/// The files beside the switch's key.
pub struct DomainStore {
    revocations: RevocationFile,
    invitations: PathBuf,
    /// How many changes, as counted by [`Domain::changes`], are saved.
    progress: RevocationStore,
}

impl DomainStore {
    /// Loads the daemon's membership, and the stored state of the domain.
    pub fn recall(
        config: &DomainConfig,
        identity: &Identity,
        identity_file: &Path,
    ) -> Result<(Self, Domain), MembershipError> {
        let papers = Arc::new(config.files.load()?);
        let mut trust = Trust::new(identity.name(), papers, config.members_only)?;
        let revocations = RevocationFile::new(identity_file.with_extension("domain-revocations"), MAX_REVOCATIONS);
        for (SignedRevocation { proof, revocation, .. }, _) in revocations.load()? {
            // The revocation may be of a domain that is no longer a peer.
            let _ = trust.take_revocation(&proof, &revocation);
        }
        let invitations = identity_file.with_extension("invitations");
        let used = load_used(&invitations)?;
        match trust.own(unix_seconds()) {
            Ok(own) => {
                let until = relative(own.not_after, unix_seconds());
                tracing::info!("{} of domain {:#} until {until}", own.role, own.domain);
            }
            Err(error) => tracing::error!("no link to anybody of a domain: {error}"),
        }
        Ok((
            Self { revocations, invitations, progress: RevocationStore::new(0) },
            Domain::new(trust, Invitations::recall(used)),
        ))
    }

    /// Waits until `changes` changes are in the files. `collect` returns the number of changes and
    /// the state to write.
    pub async fn save(
        &self,
        changes: u64,
        collect: impl FnOnce() -> Option<(u64, (Vec<SignedRevocation>, Vec<Used>))>,
    ) -> Result<(), Refusal> {
        let (file, path) = (self.revocations.clone(), self.invitations.clone());
        let write = move |(revocations, used): (Vec<SignedRevocation>, Vec<Used>)| {
            file.save(&revocations)?;
            let malformed = |error| SecretFileError::malformed(&path, error);
            secret_file::replace(&path, &cbor::encode(&used).map_err(malformed)?)
        };
        self.progress.keep(changes, collect, write).await
    }
}

fn load_used(path: &Path) -> Result<Vec<Used>, SecretFileError> {
    let bytes = match secret_file::read(path, MAX_INVITATIONS) {
        Err(error) if error.is_not_found() => return Ok(Vec::new()),
        bytes => bytes?,
    };
    cbor::decode(&bytes, MAX_INVITATIONS).map_err(|error| {
        let reason = "without it, each of them may admit another: remove it to begin anew";
        SecretFileError::malformed(path, format!("not a list of invitations ({error}); {reason}"))
    })
}
