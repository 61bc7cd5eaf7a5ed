//! The section `domain` of the configuration: the switch's membership of a trust domain.

use std::path::{Path, PathBuf};

use gdp_core::domain::{CredentialFiles, MAX_PEERS};
use schemars::JsonSchema;
use serde::Deserialize;

/// The membership of a daemon in a trust domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DomainConfig {
    /// The credential files. The daemon reloads them when they change.
    pub files: CredentialFiles,
    /// Whether endpoints without a membership get no link.
    pub members_only: bool,
    pub trace: Inside,
}

/// What a border shows other domains that trace a name through this one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Inside {
    /// Only whether frames get through, and in what time.
    #[default]
    Masked,
    /// Every switch on the path.
    Open,
}

/// The trust domain of the switch. The daemon reloads its files when they change.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct DomainEntry {
    /// The domain's card.
    card: PathBuf,
    /// The switch's membership.
    membership: PathBuf,
    /// The PeerCerts of the domain, which give rights to other domains.
    #[serde(default)]
    peers: Vec<PathBuf>,
    /// Refuses endpoints without a membership.
    #[serde(default)]
    members_only: bool,
    /// What other domains see that trace a name through this one; by default `masked`.
    #[serde(default)]
    trace: Inside,
}

impl DomainEntry {
    pub fn check(&self) -> Result<(), String> {
        match self.peers.len() {
            peers if peers > MAX_PEERS => Err(format!("domain: {peers} peers, where at most {MAX_PEERS} are shown")),
            _ => Ok(()),
        }
    }

    /// Returns the section with its paths in `folder`.
    pub fn within(self, folder: &Path) -> DomainConfig {
        let here = |path: PathBuf| folder.join(path);
        let files = CredentialFiles {
            card: here(self.card),
            membership: here(self.membership),
            peers: self.peers.into_iter().map(here).collect(),
        };
        DomainConfig { files, members_only: self.members_only, trace: self.trace }
    }
}
