//! A domain's key with the ledger of its issued certificates.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use gdp_core::cert::Revocation;
use gdp_core::identity::{Identity, SigningKey};

use super::super::issuance_log::IssuanceLog;
use super::super::revocation::next_serial;
use super::ledger::Issue;

/// A domain's key and ledger, locked while a command issues certificates.
pub struct Authority {
    pub identity: Identity,
    pub issuance_log: IssuanceLog,
    pub issued: Vec<Issue>,
    pub revocation: Option<Revocation>,
    /// Serial of the next certificate.
    pub serial: u64,
}

impl Authority {
    /// Opens key and ledger. The default location of the card is beside the key.
    pub fn open(key: &Path, card: Option<&Path>) -> anyhow::Result<Self> {
        let identity = Identity::new(SigningKey::load(key)?, "domain");
        let card = card.map_or_else(|| card_file_of(key), Path::to_path_buf);
        let issuance_log = IssuanceLog::open(&card)?;
        if issuance_log.card().name() != identity.name() {
            bail!(
                "{} is the key of domain {}, and {} the card of {}",
                key.display(),
                identity.name(),
                card.display(),
                issuance_log.card().name()
            );
        }
        let (issued, revocation) =
            (issuance_log.ledger::<Issue>()?, issuance_log.revocation()?.map(|(_, claims)| claims));
        let serial = next_serial(&issued, revocation.as_ref())?;
        Ok(Self { identity, issuance_log, issued, revocation, serial })
    }

    /// Records a certificate in the ledger. Call this before handing it out, because a certificate
    /// that is not in the ledger would not be revoked.
    pub fn remember(self, issue: Issue) -> anyhow::Result<()> {
        let mut issued = self.issued;
        issued.push(issue);
        self.issuance_log.keep_ledger(issued)
    }
}

pub fn card_file_of(key: &Path) -> PathBuf {
    key.with_extension("card")
}

/// Returns the absolute path of a file that does not exist; fails if it exists. Call this before
/// issuing anything.
pub fn expect_new(path: &Path) -> anyhow::Result<PathBuf> {
    if path.exists() {
        bail!("{}: a file of this name exists and is not overwritten", path.display());
    }
    std::path::absolute(path).with_context(|| path.display().to_string())
}
