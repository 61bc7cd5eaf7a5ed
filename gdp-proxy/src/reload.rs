//! Reloads the configuration of a running proxy, at SIGHUP and when its file or a card that it
//! names changes. The proxy applies or refuses a configuration as a whole. After a refusal it goes
//! on as before. It tries again when a file that the configuration names changes, and periodically
//! if the error may pass.
//!
//! This module does not watch the certificates and the membership of running routes: their owners
//! read them again.

use std::path::{Path, PathBuf};
use std::time::Duration;

use gdp_core::crypto::Backend;
use gdp_util::backoff::Backoff;
use gdp_util::file_watch::{FileSet, FileWatcher};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::time::{Instant, sleep_until};

use crate::config::{Config, ConfigError};
use crate::graph::GraphError;
use crate::material::Material;
use crate::material_error::MaterialError;

/// Backoff between reloads after a refusal that may pass although no file changes.
const RETRY: Backoff = Backoff::new(Duration::from_secs(5), Duration::from_secs(60));

/// A configuration with the contents of all files that it names.
pub struct Loaded {
    pub config: Config,
    pub material: Material,
}

/// Reasons for refusing a configuration.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// An error in a file that the configuration names, with the paths of all files that it names.
    #[error("{}: {error}", path.display())]
    Material { path: PathBuf, error: MaterialError, files: Vec<PathBuf> },
    #[error("{}: {key}: cannot change while the proxy runs; start it anew, or take the change back", path.display())]
    Fixed { path: PathBuf, key: String },
    #[error(transparent)]
    Graph(#[from] GraphError),
}

impl LoadError {
    /// Whether the error may pass although no file changes: a file may become readable, or the
    /// clock may be set.
    fn may_pass(&self) -> bool {
        match self {
            Self::Config(ConfigError::Io { .. } | ConfigError::Missing { .. })
            | Self::Material { .. }
            | Self::Graph(_) => true,
            Self::Config(_) | Self::Fixed { .. } => false,
        }
    }

    /// Returns the files besides the configuration whose change may fix the error.
    fn files(&self) -> &[PathBuf] {
        match self {
            Self::Material { files, .. } => files,
            Self::Config(_) | Self::Fixed { .. } | Self::Graph(_) => &[],
        }
    }
}

impl Loaded {
    pub fn load(path: &Path, watcher: &FileWatcher) -> Result<Self, LoadError> {
        let mut config = Config::load(path)?;
        // Before the first key is parsed.
        let selected = config.crypto.map_or(Ok(()), Backend::select);
        selected.map_err(|_| LoadError::Fixed { path: path.into(), key: "crypto".into() })?;
        match Material::load(&config, watcher) {
            Ok(material) => Ok(Self { config, material }),
            Err(error) => {
                let files = config.files().map(|file| file.clone()).collect();
                Err(LoadError::Material { path: path.into(), error, files })
            }
        }
    }

    /// Loads the same file again. It refuses changes of keys that cannot change while the proxy
    /// runs.
    pub fn load_again(&self, path: &Path, watcher: &FileWatcher) -> Result<Self, LoadError> {
        let new = Self::load(path, watcher)?;
        let fixed = |key: String| LoadError::Fixed { path: path.into(), key };
        if new.material.identity.name() != self.material.identity.name() {
            return Err(fixed("identity".into()));
        }
        match self.config.fixed_that_differs(&new.config) {
            Some(key) => Err(fixed(key)),
            None => Ok(new),
        }
    }

    /// Returns the files that only this module watches: cards, catalogs and the owner's key.
    pub fn cards(&self) -> impl Iterator<Item = &Path> {
        let config = &self.config;
        let topics = config.topics.iter().map(|topic| topic.card.as_path());
        let imports = config.import.iter().map(|import| import.catalog.as_path());
        let calls = config.calls().map(|(_, call)| call.card.as_path());
        topics
            .chain(calls)
            .chain(imports)
            .chain(config.expose.iter().flat_map(|expose| [expose.catalog.as_path(), &expose.owner]))
    }
}

/// Signals when the configuration must be loaded again.
pub struct Watch {
    path: PathBuf,
    hangup: Signal,
    watcher: FileWatcher,
    /// The configuration and the files that it names.
    files: FileSet,
    /// Time of the next attempt after a refusal.
    again: Option<Instant>,
    /// Backoff of further attempts.
    retry: Backoff,
    /// The error last reported.
    reported: Option<String>,
}

impl Watch {
    /// Watches a configuration that is about to be loaded. From now on, SIGHUP no longer kills the
    /// process.
    pub fn new(path: &Path, watcher: &FileWatcher) -> std::io::Result<Self> {
        let (hangup, files) = (signal(SignalKind::hangup())?, FileSet::new(watcher, [path]));
        let (path, watcher, again, reported) = (path.into(), watcher.clone(), None, None);
        Ok(Self { path, hangup, watcher, files, again, retry: RETRY, reported })
    }

    pub fn watcher(&self) -> &FileWatcher {
        &self.watcher
    }

    /// Returns the configuration's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Records that the configuration was loaded and runs.
    pub fn taken(&mut self, loaded: &Loaded) {
        (self.again, self.retry, self.reported) = (None, RETRY, None);
        self.look_at(loaded.cards());
    }

    /// Records that the configuration was refused and the one before goes on. Returns true if the
    /// error differs from the one reported last.
    pub fn refused(&mut self, loaded: &Loaded, error: &LoadError) -> bool {
        self.look_at(loaded.cards().chain(error.files().iter().map(PathBuf::as_path)));
        self.again = error.may_pass().then(|| Instant::now() + self.retry.next_delay());
        let said = error.to_string();
        let is_new = self.reported.as_ref() != Some(&said);
        self.reported = Some(said);
        is_new
    }

    /// Watches the configuration and the files of `named`, and no others.
    fn look_at<'a>(&mut self, named: impl IntoIterator<Item = &'a Path>) {
        let mut paths = vec![self.path.as_path()];
        paths.extend(named.into_iter().map(|path| path as &Path));
        self.files.replace(paths);
    }

    /// Returns at SIGHUP, after a watched file changed and its writer finished, or when a refused
    /// configuration is due for another attempt. Cancel-safe.
    pub async fn changed(&mut self) {
        let again = self.again;
        let is_another = tokio::select! {
            Some(()) = self.hangup.recv() => true,
            () = self.files.changed() => true,
            () = sleep_until(again.unwrap_or_else(Instant::now)), if again.is_some() => false,
        };
        if is_another {
            // The next error is logged, even if it is the same one again.
            (self.retry, self.reported) = (RETRY, None);
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/reload.rs"]
mod tests;
