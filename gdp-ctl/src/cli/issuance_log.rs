//! Files beside the card of a name or a domain: the ledger of certificates issued here
//! (`CARD.grants`, `CARD.members`), and `CARD.revocation`, the newest revocation. Both are written
//! atomically with mode 0600. No other command changes them while an [`IssuanceLog`] is open.
//!
//! The revocation is signed by the owner and is verified. The ledger is only a record. Without the
//! ledger all grants remain valid, but only a serial or a file can identify them.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use gdp_core::card::NameCard;
use gdp_core::cert::{Revocation, Signed};
use gdp_core::secret_file;
use gdp_util::escape::escape_json;
use gdp_util::text_file;
use gdp_wire::Name;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

const VERSION: u32 = 1;

/// Maximum size in bytes; an entry has about 300 bytes.
const MAX_LEDGER: usize = 4 << 20;

const MAX_REVOCATION: u64 = 16 << 10;

/// The card of a name, and the files beside it.
pub struct IssuanceLog {
    card: NameCard,
    path: PathBuf,
    /// Lock on the card itself, which no command replaces.
    _lock: File,
}

/// A certificate that was issued here.
pub trait Entry: Serialize + DeserializeOwned {
    /// Suffix of the ledger's file name.
    const SUFFIX: &'static str;

    fn serial(&self) -> u64;
    /// Returns the time at which the certificate and all that depend on it have expired.
    fn ends(&self) -> u64;
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Ledger<E> {
    version: u32,
    name: Name,
    issued: Vec<E>,
}

impl IssuanceLog {
    /// Opens and locks the files. Waits for another command that has locked them.
    pub fn open(card: &Path) -> anyhow::Result<Self> {
        let issuance_log = Self {
            card: NameCard::load(card)?,
            path: card.into(),
            _lock: File::open(card).with_context(|| format!("cannot open {}", card.display()))?,
        };
        issuance_log._lock.lock().with_context(|| format!("cannot lock {}", card.display()))?;
        Ok(issuance_log)
    }

    pub fn card(&self) -> &NameCard {
        &self.card
    }

    pub fn ledger_path<E: Entry>(&self) -> PathBuf {
        self.sibling(E::SUFFIX)
    }

    pub fn revocation_path(&self) -> PathBuf {
        self.sibling(".revocation")
    }

    /// Returns the certificates issued here, in the order of serials.
    pub fn ledger<E: Entry>(&self) -> anyhow::Result<Vec<E>> {
        let path = self.ledger_path::<E>();
        let Some(content) = secret_file::read_optional(&path, MAX_LEDGER)? else { return Ok(Vec::new()) };
        let ledger: Ledger<E> = serde_json::from_slice(&content)
            .with_context(|| format!("{}: not a ledger of what was issued", path.display()))?;
        if ledger.version != VERSION || ledger.name != self.card.name() {
            let (version, name) = (ledger.version, ledger.name);
            bail!(
                "{}: version {version} for {name}, where version {VERSION} for {} is expected",
                path.display(),
                self.card.name()
            );
        }
        Ok(ledger.issued)
    }

    pub fn keep_ledger<E: Entry>(&self, issued: Vec<E>) -> anyhow::Result<()> {
        let ledger = Ledger { version: VERSION, name: self.card.name(), issued };
        let text = escape_json(&serde_json::to_string_pretty(&ledger)?).into_owned() + "\n";
        let path = self.ledger_path::<E>();
        if text.len() > MAX_LEDGER {
            bail!("{}: longer than {MAX_LEDGER} bytes; make a new name, or a new copy of the card", path.display());
        }
        Ok(secret_file::replace(&path, text.as_bytes())?)
    }

    /// Returns the newest local revocation of the name.
    pub fn revocation(&self) -> anyhow::Result<Option<(Signed<Revocation>, Revocation)>> {
        newest_revocation(&self.card, &self.revocation_path())
    }

    pub fn keep_revocation(&self, signed: &Signed<Revocation>) -> anyhow::Result<()> {
        Ok(secret_file::replace(&self.revocation_path(), signed.to_pem().as_bytes())?)
    }

    fn sibling(&self, suffix: &str) -> PathBuf {
        let mut name = self.path.file_name().unwrap_or_default().to_owned();
        name.push(suffix);
        self.path.with_file_name(name)
    }
}

/// Returns the revocation in this file, if it exists. The file is replaced as a whole, so it needs
/// no lock.
pub fn newest_revocation(card: &NameCard, path: &Path) -> anyhow::Result<Option<(Signed<Revocation>, Revocation)>> {
    // The owner's signature protects it, and everybody may read it.
    let text = match text_file::read(path, MAX_REVOCATION) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        text => text.with_context(|| format!("cannot read {}", path.display()))?,
    };
    let check = || -> anyhow::Result<_> {
        let text = text.with_context(|| format!("longer than {MAX_REVOCATION} bytes, so not a revocation"))?;
        let signed = Signed::<Revocation>::from_pem(&text)?;
        let claims = signed.verify_revocation(&card.proof())?;
        Ok((signed, claims))
    };
    check().map(Some).with_context(|| path.display().to_string())
}
