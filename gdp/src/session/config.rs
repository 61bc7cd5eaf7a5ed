//! What a session is opened with.

use std::path::PathBuf;
use std::time::Duration;

use gdp_core::identity::{Identity, KeyFile};
use gdp_core::link_target::LinkTarget;

use super::error::Error;
use super::followed_keyring::FollowedKeyring;
use crate::keyring::Keyring;
use crate::node::{LinkConfig, NodeConfig};

/// Kind of the entity of a key whose file states none.
const DEFAULT_KIND: &str = "proxy";

/// Where a switch of this machine listens by default.
const LOCAL_PORT: u16 = 31415;

/// What a session is opened with: a keyring, and where the switch is.
///
/// The folder of a keyring has the private key (`id.pem`), name cards (`*.card`), and certificates
/// (`*.ad`, `*.grant`). The folder that `gdp-ctl join` or `gdp-proxy join` wrote works as well.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Config {
    keyring: PathBuf,
    key: Option<PathBuf>,
    switches: Vec<LinkTarget>,
    state: Option<PathBuf>,
    timeout: Duration,
}

impl Config {
    /// Returns a configuration with this keyring.
    pub fn new(keyring: impl Into<PathBuf>) -> Self {
        let timeout = Duration::from_secs(10);
        Self { keyring: keyring.into(), key: None, switches: Vec::new(), state: None, timeout }
    }

    /// Returns the configuration that `gdp-ctl topic` uses as well.
    ///
    /// `GDP_KEYRING` names the keyring. Without it, that is `~/.config/gdp`, or `/etc/gdp` if root
    /// has joined a domain. `GDP_SWITCH` names the switch, for example `udp://203.0.113.7:31415`.
    ///
    /// # Errors
    ///
    /// Fails if `GDP_SWITCH` is no link, or if `HOME` is needed and not set.
    pub fn from_env() -> Result<Self, Error> {
        let config = match std::env::var_os("GDP_KEYRING") {
            Some(folder) => Self::new(folder),
            None => Self::new(Keyring::default_folder()?),
        };
        match std::env::var_os("GDP_SWITCH") {
            Some(text) => Ok(config.switch(text.to_string_lossy().parse()?)),
            None => Ok(config),
        }
    }

    /// Uses this private key instead of the keyring's.
    pub fn key(mut self, file: impl Into<PathBuf>) -> Self {
        self.key = Some(file.into());
        self
    }

    /// Adds a switch to attach to, of one domain with the others. The first that is up carries all
    /// traffic. Without any, the session attaches where the keyring's owner joined, or else to the
    /// switch of this machine.
    pub fn switch(mut self, target: LinkTarget) -> Self {
        self.switches.push(target);
        self
    }

    /// Stores the revocations that the session receives in a folder. Without one, the session
    /// forgets them when it ends.
    pub fn state(mut self, folder: impl Into<PathBuf>) -> Self {
        self.state = Some(folder.into());
        self
    }

    /// Sets how long [`open`](super::open) tries to attach. Default: 10 s.
    pub fn timeout(mut self, timeout: Duration) -> Self {
        self.timeout = timeout;
        self
    }

    /// Reads the keyring, the key and the links.
    pub(super) fn load(self) -> Result<(FollowedKeyring, NodeConfig), Error> {
        let mut keyring = FollowedKeyring::open(&self.keyring)?;
        let file = self.key.unwrap_or_else(|| Keyring::key_file(&self.keyring));
        let key = KeyFile::load(&file).map_err(|source| Error::Key { file: file.clone(), source })?;
        let identity: Identity = key.identity_or(DEFAULT_KIND);
        let links: Vec<LinkConfig> = match (self.switches, Keyring::links(&self.keyring)) {
            (switches, _) if !switches.is_empty() => switches.into_iter().map(LinkConfig::from).collect(),
            (_, links) => match links? {
                Some(links) => links,
                None => vec![local_switch().into()],
            },
        };
        let credentials = keyring.current().credentials.as_ref().map(|files| files.load()).transpose()?;
        let config = NodeConfig::new(identity, local_switch());
        let (connect_timeout, state) = (self.timeout, self.state);
        Ok((keyring, NodeConfig { links, credentials, connect_timeout, state, ..config }))
    }
}

fn local_switch() -> LinkTarget {
    LinkTarget::Udp { host: "127.0.0.1".into(), port: LOCAL_PORT, interface: None }
}
