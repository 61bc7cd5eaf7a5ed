//! The keyring of a session, which is read again when its folder has changed.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Issued, Reading};
use gdp_util::file_watch::FileStamp;
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;

use crate::keyring::members::SharedName;
use crate::keyring::{Keyring, KeyringError, RightError};

/// A keyring, and the rights that other members have shared.
pub struct FollowedKeyring {
    folder: PathBuf,
    stamps: Vec<(PathBuf, Option<FileStamp>)>,
    keyring: Keyring,
    /// The last grant for each name of another member.
    shared: HashMap<Name, Reading>,
}

impl FollowedKeyring {
    pub fn open(folder: &Path) -> Result<Self, KeyringError> {
        // Before the files are read, so that no change is missed.
        let stamps = stamps(folder);
        let keyring = read(folder)?;
        Ok(Self { folder: folder.into(), stamps, keyring, shared: HashMap::new() })
    }

    /// Returns what is in the folder now, or was when it could last be read.
    pub fn current(&mut self) -> &Keyring {
        let stamps = stamps(&self.folder);
        if stamps != self.stamps {
            self.stamps = stamps;
            match read(&self.folder) {
                Ok(keyring) => self.keyring = keyring,
                Err(error) => tracing::warn!("the keyring is not read again: {error}"),
            }
        }
        &self.keyring
    }

    /// Stores the right that another member has shared, instead of an earlier one.
    pub fn share(&mut self, SharedName { card, grant, .. }: SharedName) -> NameCard {
        self.shared.insert(card.name(), grant);
        card
    }

    /// Returns a grant for `entity` to read the name, from the folder or else of another member.
    pub fn grant(&mut self, card: &NameCard, entity: Name) -> Result<Reading, RightError> {
        let now = unix_seconds();
        let own = self.current().grant(card, entity, now);
        let shared = self.shared.get(&card.name());
        match (own, shared.filter(|grant| grant.verify(&card.proof(), entity, None, now).is_ok())) {
            (Err(_), Some(shared)) => Ok(shared.clone()),
            (own, _) => own,
        }
    }

    /// Returns a certificate for `entity` to publish the name.
    pub fn ad(&mut self, card: &NameCard, entity: Name) -> Result<Issued<AdCert>, RightError> {
        self.current().ad(card, entity, unix_seconds())
    }
}

fn read(folder: &Path) -> Result<Keyring, KeyringError> {
    let keyring = Keyring::open(folder)?;
    for reason in &keyring.left_out {
        tracing::warn!("left out of the keyring: {reason}");
    }
    Ok(keyring)
}

/// Returns the files with their stamps. A folder that cannot be listed has none.
fn stamps(folder: &Path) -> Vec<(PathBuf, Option<FileStamp>)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut stamps: Vec<_> =
        entries.map(|entry| entry.path()).map(|path| (path.clone(), FileStamp::of(&path))).collect();
    stamps.sort_by(|(one, _), (other, _)| one.cmp(other));
    stamps
}
