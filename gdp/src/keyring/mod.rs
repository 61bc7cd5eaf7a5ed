//! A user's folder of name cards, certificates and one entity key. It provides the rights to read
//! or publish a topic by its ROS name.
//!
//! `gdp-ctl name create` and `gdp-ctl grant add` create `*.card`, `*.grant` and `*.ad`. `*.member`
//! (or `membership`) and the domain's card prove that the entity is a member of the domain.
//! `*.peer` are certificates of that domain for other domains. Invalid files are reported and
//! omitted.

mod error;
mod files;
mod joined;
pub mod members;

use std::path::{Path, PathBuf};

use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, CertError, Issued, Reading};
use gdp_core::domain::CredentialFiles;
use gdp_core::name::NamePrefix;
use gdp_util::folders;
use gdp_wire::Name;

use self::files::RightFile;
use crate::node::LinkConfig;

pub use self::error::{FindError, KeyringError, MissingRight, RightError};

/// Maximum number of folder entries that are read.
const MAX_ENTRIES: usize = 10_000;

/// The key of a member that joined a domain.
const MEMBER_KEY: &str = "proxy.pem";
/// The key in a keyring that a user made.
const OWN_KEY: &str = "id.pem";

/// The right to read the directory of a domain.
#[derive(Debug)]
pub struct DirectoryRight {
    /// The card of the directory's name.
    pub card: NameCard,
    /// The domain.
    pub domain: Name,
    /// The right to read it.
    pub grant: Reading,
}

/// Contents of the folder.
#[derive(Clone, Debug, Default)]
pub struct Keyring {
    folder: PathBuf,
    /// In the order of their files.
    cards: Vec<NameCard>,
    ads: Vec<(PathBuf, Name, Issued<AdCert>)>,
    grants: Vec<(PathBuf, Name, Reading)>,
    /// Credentials of the domain of which the entity is a member.
    pub credentials: Option<CredentialFiles>,
    /// Omitted files, each with the reason.
    pub left_out: Vec<String>,
}

impl Keyring {
    /// Returns the folder of this user: the keyring that has a key, or else the folder of
    /// `gdp-proxy join` or `gdp-ctl join`.
    ///
    /// # Errors
    ///
    /// Fails if neither XDG_CONFIG_HOME nor HOME is set.
    pub fn default_folder() -> Result<PathBuf, KeyringError> {
        let own = folders::keyring();
        let has_key = own.as_ref().is_some_and(|folder| folder.join(OWN_KEY).exists());
        let joined = folders::configuration().filter(|folder| !has_key && Self::is_joined(folder));
        joined.or(own).ok_or(KeyringError::Unset)
    }

    /// Returns the file of the entity's private key in a folder.
    pub fn key_file(folder: &Path) -> PathBuf {
        folder.join(if Self::is_joined(folder) { MEMBER_KEY } else { OWN_KEY })
    }

    /// Returns the links by which a member attaches to its domain, in order of preference. Returns
    /// `None` if no member's folder is at this path.
    ///
    /// # Errors
    ///
    /// Fails if the member's `proxy.yaml` names no link.
    pub fn links(folder: &Path) -> Result<Option<Vec<LinkConfig>>, KeyringError> {
        Self::is_joined(folder).then(|| joined::links(folder)).transpose()
    }

    /// Reads a folder. Invalid files are omitted: see [`Self::left_out`].
    ///
    /// # Errors
    ///
    /// Fails if the folder cannot be listed.
    pub fn open(folder: &Path) -> Result<Self, KeyringError> {
        let io = |source| KeyringError::Folder { path: folder.into(), source };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(io)? {
            if files.len() >= MAX_ENTRIES {
                return Err(KeyringError::TooMany { path: folder.into(), most: MAX_ENTRIES });
            }
            files.push(entry.map_err(io)?.path());
        }
        files.sort();
        let mut keyring = Self { folder: folder.into(), ..Self::default() };
        let (mut domains, mut members, mut peers) = (Vec::new(), Vec::new(), Vec::new());
        for file in files {
            let ending = file.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
            let is_membership = ending == "member" || file.file_name().is_some_and(|name| name == "membership");
            let taken = match ending {
                "card" => keyring.card(&file).map(|is_domain| domains.extend(is_domain.then(|| file.clone()))),
                "ad" | "grant" => keyring.right(&file),
                _ => Ok(()),
            };
            if is_membership {
                members.push(file.clone());
            } else if ending == "peer" {
                peers.push(file.clone());
            }
            if let Err(reason) = taken {
                let file = file.display().to_string();
                let reason = if reason.contains(&file) { reason } else { format!("{file}: {reason}") };
                keyring.left_out.push(reason);
            }
        }
        match (&domains[..], &members[..]) {
            (_, []) => {}
            ([card], [membership]) => {
                keyring.credentials =
                    Some(CredentialFiles { card: card.clone(), membership: membership.clone(), peers });
            }
            _ => keyring.left_out.push(format!(
                "{} memberships and {} cards of domains: one of each makes a member",
                members.len(),
                domains.len()
            )),
        }
        Ok(keyring)
    }

    /// Adds a card. Returns `true` for the card of a domain, which is not added.
    fn card(&mut self, file: &Path) -> Result<bool, String> {
        let card = NameCard::load(file).map_err(|error| error.to_string())?;
        if card.get("kind") == Some("domain") {
            return Ok(true);
        }
        if !self.cards.contains(&card) {
            self.cards.push(card);
        }
        Ok(false)
    }

    fn right(&mut self, file: &Path) -> Result<(), String> {
        let name = |claimed: Result<Name, CertError>| claimed.map_err(|error| error.to_string());
        match files::read(file)? {
            RightFile::Publish(ad) => {
                let of = name(ad.cert.claims_unverified().map(|claims| claims.name))?;
                self.ads.push((file.into(), of, ad));
            }
            RightFile::Read(reading) => {
                let of = name(reading.grant.cert.claims_unverified().map(|claims| claims.name))?;
                self.grants.push((file.into(), of, reading));
            }
        }
        Ok(())
    }

    /// Returns the card and grant of the domain's directory, and the domain, if the folder is that
    /// of a member.
    pub fn directory(&self, entity: Name, now: u64) -> Option<Result<DirectoryRight, RightError>> {
        let (card, domain) = self.directory_card()?;
        let right = self.grant(&card, entity, now);
        Some(right.map(|grant| DirectoryRight { card, domain, grant }))
    }

    /// Returns whether the folder has a grant to read the domain's directory.
    pub fn has_directory(&self) -> bool {
        self.directory_card().is_some()
    }

    /// Returns the directory's card and the domain, if the folder has a grant to read it.
    fn directory_card(&self) -> Option<(NameCard, Name)> {
        let domain = NameCard::load(&self.credentials.as_ref()?.card).ok()?.name();
        let card = self.cards.iter().find(|card| card.get("kind") == Some("directory"))?;
        self.grants.iter().any(|(_, of, _)| *of == card.name()).then(|| (card.clone(), domain))
    }

    /// Adds a name with a right to read it, for the time of the command.
    pub fn add(&mut self, card: &NameCard, grant: Reading) {
        self.grants.push((self.folder.clone(), card.name(), grant));
        if !self.cards.contains(card) {
            self.cards.push(card.clone());
        }
    }

    /// Returns whether the folder is that of a member that joined the domain, and has no other key.
    pub fn is_joined(folder: &Path) -> bool {
        !folder.join(OWN_KEY).exists() && folder.join(MEMBER_KEY).is_file() && folder.join("membership").is_file()
    }

    /// Returns the cards of this kind: `topic`, `service` or `action`.
    pub fn cards(&self, kind: &str) -> impl Iterator<Item = &NameCard> {
        self.cards.iter().filter(move |card| card.get("kind") == Some(kind))
    }

    /// Finds a card by its ROS name, its name or a prefix of it, or its file.
    pub fn find(&self, what: &str, kind: &str) -> Result<NameCard, FindError> {
        let rooted = if what.starts_with('/') { what.to_owned() } else { format!("/{what}") };
        let called = |card: &&NameCard| card.get("topic").is_some_and(|topic| topic == rooted || topic == what);
        let mut found: Vec<NameCard> = self.cards(kind).filter(called).cloned().collect();
        if found.is_empty() && Path::new(what).is_file() {
            found.extend(NameCard::load(Path::new(what)).ok());
        }
        if let (true, Ok(prefix)) = (found.is_empty(), what.parse::<NamePrefix>()) {
            found.extend(self.cards.iter().filter(|card| prefix.matches(&card.name())).cloned());
        }
        let (what, kind) = (what.to_owned(), kind.to_owned());
        match found.pop() {
            None => Err(FindError::Unknown { what, kind, folder: self.folder.clone() }),
            Some(one) if found.is_empty() => match one.get("kind") {
                Some(got) if got != kind => Err(FindError::Other { what, kind, got: got.to_owned() }),
                _ => Ok(one),
            },
            Some(last) => {
                let names = found.iter().chain([&last]).map(NameCard::name).collect();
                Err(FindError::Ambiguous { what, kind, names })
            }
        }
    }

    /// Returns a grant for `entity` to read the name.
    pub fn grant(&self, card: &NameCard, entity: Name, now: u64) -> Result<Reading, RightError> {
        let ours = self.grants.iter().filter(|(_, of, _)| *of == card.name());
        let checked = ours.map(|(file, _, grant)| {
            let until = grant.verify(&card.proof(), entity, None, now).map(|claims| claims.not_after);
            (file, grant, until)
        });
        newest(checked, card)?.cloned().ok_or_else(|| self.missing("grant to read", "--read", "grant", card, entity))
    }

    /// Returns a certificate for `entity` to publish the name.
    pub fn ad(&self, card: &NameCard, entity: Name, now: u64) -> Result<Issued<AdCert>, RightError> {
        let ours = self.ads.iter().filter(|(_, of, _)| *of == card.name());
        let checked = ours.map(|(file, _, ad)| {
            let until = ad.verify_for(&card.proof(), entity, None, now).map(|claims| claims.not_after);
            (file, ad, until)
        });
        newest(checked, card)?
            .cloned()
            .ok_or_else(|| self.missing("certificate to publish", "--publish", "ad", card, entity))
    }

    fn missing(
        &self,
        what: &'static str,
        option: &'static str,
        ending: &'static str,
        card: &NameCard,
        entity: Name,
    ) -> RightError {
        let of = called(card).to_owned();
        let missing = MissingRight { what, option, ending, of, name: card.name(), entity, folder: self.folder.clone() };
        RightError::Missing(missing.into())
    }
}

/// Returns the ROS name of a card.
pub fn called(card: &NameCard) -> &str {
    card.get("topic").unwrap_or("a name without a topic")
}

/// Returns the valid certificate with the latest expiry. If none is valid, returns the error of
/// one, or `None` if there are none.
fn newest<'a, T>(
    checked: impl Iterator<Item = (&'a PathBuf, &'a T, Result<u64, CertError>)>,
    card: &NameCard,
) -> Result<Option<&'a T>, RightError> {
    let (mut best, mut refused) = (None, None);
    for (file, right, until) in checked {
        match until {
            Ok(until) if best.is_none_or(|(before, _)| until > before) => best = Some((until, right)),
            Ok(_) => {}
            Err(source) => {
                refused =
                    Some(RightError::Refused { file: file.clone(), of: called(card).into(), source: source.into() })
            }
        }
    }
    match (best, refused) {
        (Some((_, right)), _) => Ok(Some(right)),
        (None, Some(refused)) => Err(refused),
        (None, None) => Ok(None),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/keyring/mod.rs"]
mod tests;
