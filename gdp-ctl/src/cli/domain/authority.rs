//! A domain's key with the ledger of its issued certificates.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use gdp_core::cert::Revocation;
use gdp_core::identity::{Identity, SigningKey};

use super::super::issuance_log::IssuanceLog;
use super::super::revocation::next_serial;
use super::ledger::Issue;

/// A domain's ledger, locked while a command uses it.
pub struct DomainLedger {
    pub issuance_log: IssuanceLog,
    pub issued: Vec<Issue>,
    pub revocation: Option<Revocation>,
}

impl DomainLedger {
    /// Opens the ledger beside a domain's card.
    pub fn open(card: &Path) -> anyhow::Result<Self> {
        let issuance_log = IssuanceLog::open(card)?;
        let (issued, revocation) =
            (issuance_log.ledger::<Issue>()?, issuance_log.revocation()?.map(|(_, claims)| claims));
        Ok(Self { issuance_log, issued, revocation })
    }
}

/// A domain's key, or that of its successor, with the ledger.
pub struct Authority {
    pub identity: Identity,
    pub ledger: DomainLedger,
    /// Serial of the next certificate.
    pub serial: u64,
}

impl Authority {
    /// Opens key and ledger. The default location of the card is beside the key.
    pub fn open(key: &Path, card: Option<&Path>) -> anyhow::Result<Self> {
        let signing_key = SigningKey::load(key)?;
        let card = card.map_or_else(|| card_file_of(key), Path::to_path_buf);
        let ledger = DomainLedger::open(&card)?;
        let known = ledger.issuance_log.card();
        if !known.is_domain() {
            bail!("{}: not the card of a domain; `gdp-ctl domain init` makes one", card.display());
        }
        let Some(identity) = Identity::of_domain(signing_key.clone(), known) else {
            let of = Identity::new(signing_key, "domain").name();
            bail!("{} is the key of domain {of}, and {} the card of {}", key.display(), card.display(), known.name());
        };
        if let Some(signer) = ledger.revocation.as_ref().and_then(|revocation| revocation.signer)
            && signer != identity.key().verify_key()
        {
            bail!("{}: this key of the domain is retired; use the key that succeeded it", key.display());
        }
        let serial = next_serial(&ledger.issued, ledger.revocation.as_ref())?;
        Ok(Self { identity, ledger, serial })
    }

    /// Records a certificate in the ledger. Call this before handing it out, because a certificate
    /// that is not in the ledger would not be revoked.
    pub fn remember(self, issue: Issue) -> anyhow::Result<()> {
        let mut issued = self.ledger.issued;
        issued.push(issue);
        self.ledger.issuance_log.keep_ledger(issued)
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
