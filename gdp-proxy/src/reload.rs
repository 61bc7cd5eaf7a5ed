//! The configuration of a proxy that runs: read again at SIGHUP and when it, or a card that it
//! names, is another file. What does not do as a whole is refused as a whole, and everything goes
//! on as it was; it is tried again whenever one of the files that it names is another one, and from
//! time to time.
//!
//! Certificates and the membership of what runs are not looked at here: they are read again by
//! those who hold them.

use std::path::{Path, PathBuf};
use std::time::Duration;

use gdp_util::backoff::Backoff;
use gdp_util::file_watch::{FileSet, FileWatcher};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::time::{Instant, sleep_until};

use crate::config::{Config, ConfigError};
use crate::graph::GraphError;
use crate::material::Material;
use crate::material_error::MaterialError;

/// Before what was refused is tried again though no file is another one, if it may pass by itself:
/// doubled from the first to the second.
const RETRY: Backoff = Backoff::new(Duration::from_secs(5), Duration::from_secs(60));

/// A configuration with all that it names.
pub struct Loaded {
    pub config: Config,
    pub material: Material,
}

/// Why a configuration is not taken.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// With all files that the configuration names.
    #[error("{}: {error}", path.display())]
    Material { path: PathBuf, error: MaterialError, files: Vec<PathBuf> },
    #[error("{}: {key}: cannot change while the proxy runs; start it anew, or take the change back", path.display())]
    Fixed { path: PathBuf, key: String },
    #[error(transparent)]
    Graph(#[from] GraphError),
}

impl LoadError {
    /// Whether it may be otherwise though no file is another one: one may be readable by now, or
    /// the clock may be right.
    fn may_pass(&self) -> bool {
        match self {
            Self::Config(ConfigError::Io { .. }) | Self::Material { .. } | Self::Graph(_) => true,
            Self::Config(_) | Self::Fixed { .. } => false,
        }
    }

    /// The files besides the configuration of which another one may mend it.
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
        match Material::load(&config, watcher) {
            Ok(material) => Ok(Self { config, material }),
            Err(error) => {
                let files = config.files().map(|file| file.clone()).collect();
                Err(LoadError::Material { path: path.into(), error, files })
            }
        }
    }

    /// The same file as it is now, unless it differs in what cannot change.
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

    /// The files that nobody else looks at.
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

/// Says when to load again.
pub struct Watch {
    path: PathBuf,
    hangup: Signal,
    watcher: FileWatcher,
    /// The configuration, and what it names.
    files: FileSet,
    /// When what was refused is tried again, how long the next pause is, and what was said of it.
    again: Option<Instant>,
    retry: Backoff,
    reported: Option<String>,
}

impl Watch {
    /// Of a configuration that is about to be loaded. From now on, SIGHUP no longer kills the
    /// process.
    pub fn new(path: &Path, watcher: &FileWatcher) -> std::io::Result<Self> {
        let (hangup, files) = (signal(SignalKind::hangup())?, FileSet::new(watcher, [path]));
        let (path, watcher, again, reported) = (path.into(), watcher.clone(), None, None);
        Ok(Self { path, hangup, watcher, files, again, retry: RETRY, reported })
    }

    pub fn watcher(&self) -> &FileWatcher {
        &self.watcher
    }

    /// The configuration.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// It was loaded, and is what runs.
    pub fn taken(&mut self, loaded: &Loaded) {
        (self.again, self.retry, self.reported) = (None, RETRY, None);
        self.look_at(loaded.cards());
    }

    /// It was not, and what was loaded before goes on. Whether the reason is another one than
    /// before.
    pub fn refused(&mut self, loaded: &Loaded, error: &LoadError) -> bool {
        self.look_at(loaded.cards().chain(error.files().iter().map(PathBuf::as_path)));
        self.again = error.may_pass().then(|| Instant::now() + self.retry.next_delay());
        let said = error.to_string();
        let is_new = self.reported.as_ref() != Some(&said);
        self.reported = Some(said);
        is_new
    }

    /// Besides the configuration, `named` are watched from now on.
    fn look_at<'a>(&mut self, named: impl IntoIterator<Item = &'a Path>) {
        let mut paths = vec![self.path.as_path()];
        paths.extend(named.into_iter().map(|path| path as &Path));
        self.files.replace(paths);
    }

    /// Returns at SIGHUP, when a file is another than it was and was not written just now, or when
    /// what was refused is to be tried again. Cancel-safe.
    pub async fn changed(&mut self) {
        let again = self.again;
        let is_another = tokio::select! {
            Some(()) = self.hangup.recv() => true,
            () = self.files.changed() => true,
            () = sleep_until(again.unwrap_or_else(Instant::now)), if again.is_some() => false,
        };
        if is_another {
            // So it is news, whatever comes of it.
            (self.retry, self.reported) = (RETRY, None);
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/reload.rs"]
mod tests;
