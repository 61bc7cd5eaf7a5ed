//! The configuration of a proxy that runs: read again at SIGHUP and when it, or a card that it names, is another file. What does not do as a whole is refused
//! as a whole, and everything goes on as it was.
//!
//! Certificates and the membership are not looked at here: they are read again by those who hold them.

use std::path::{Path, PathBuf};
use std::time::Duration;

use gdp::file_stamp::FileStamp;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::time::MissedTickBehavior;

use crate::config::{Config, ConfigError};
use crate::material::{Material, MaterialError};

/// How often the files are looked at.
const LOOK: Duration = Duration::from_secs(1);

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
    #[error("{}: {error}", path.display())]
    Material { path: PathBuf, error: MaterialError },
    #[error("{}: {key}: cannot change while the proxy runs; start it anew, or take the change back", path.display())]
    Fixed { path: PathBuf, key: String },
}

impl Loaded {
    pub fn load(path: &Path) -> Result<Self, LoadError> {
        let config = Config::load(path)?;
        let material = Material::load(&config);
        let material = material.map_err(|error| LoadError::Material { path: path.into(), error })?;
        Ok(Self { config, material })
    }

    /// The same file as it is now, unless it differs in what cannot change.
    pub fn load_again(&self, path: &Path) -> Result<Self, LoadError> {
        let new = Self::load(path)?;
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
    ticks: tokio::time::Interval,
    /// With what they were like when they were loaded, and when they were looked at last.
    files: Vec<(PathBuf, Option<FileStamp>, Option<FileStamp>)>,
}

impl Watch {
    /// Of a configuration that is about to be loaded. From now on, SIGHUP no longer kills the process.
    pub fn new(path: &Path) -> std::io::Result<Self> {
        let mut ticks = tokio::time::interval(LOOK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut watch = Self { path: path.into(), hangup: signal(SignalKind::hangup())?, ticks, files: vec![] };
        watch.look_at([]);
        Ok(watch)
    }

    /// The configuration.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Besides the configuration, `named` are looked at from now on.
    pub fn look_at<'a>(&mut self, named: impl IntoIterator<Item = &'a Path>) {
        let paths = std::iter::once(self.path.clone()).chain(named.into_iter().map(PathBuf::from));
        self.files = paths
            .map(|path| {
                let known = self.files.iter().find(|(known, ..)| *known == path);
                let stamp = known.map_or_else(|| FileStamp::of(&path), |(_, loaded, _)| *loaded);
                (path, stamp, stamp)
            })
            .collect();
    }

    /// Returns at SIGHUP, or when a file is another than it was, and was not written just now. What is there then counts as loaded. Safe to
    /// cancel.
    pub async fn changed(&mut self) {
        loop {
            tokio::select! {
                Some(()) = self.hangup.recv() => break,
                _ = self.ticks.tick() => {
                    if self.look() {
                        break;
                    }
                }
            }
        }
        for (path, loaded, last) in &mut self.files {
            (*loaded, *last) = [FileStamp::of(path); 2].into();
        }
    }

    /// Whether one has changed, and all stay as they are.
    fn look(&mut self) -> bool {
        let (mut changed, mut settled) = (false, true);
        for (path, loaded, last) in &mut self.files {
            let now = FileStamp::of(path);
            // Gone: about to be replaced, perhaps.
            changed |= now.is_some() && now != *loaded;
            settled &= now == *last;
            *last = now;
        }
        changed && settled
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::material::tests::Files;

    #[tokio::test]
    async fn a_file_that_is_another_is_noticed_once_and_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let (config, card) = (folder.path().join("proxy.yaml"), folder.path().join("t.card"));
        fs::write(&config, "a").unwrap();
        fs::write(&card, "a").unwrap();
        let mut watch = Watch::new(&config).unwrap();
        watch.look_at([card.as_path()]);
        assert!(!watch.look());
        for file in [&config, &card] {
            fs::write(folder.path().join("new"), "b").unwrap();
            fs::rename(folder.path().join("new"), file).unwrap();
            assert!(!watch.look(), "it may be written still");
            let changed = tokio::time::timeout(Duration::from_secs(20), watch.changed());
            changed.await.unwrap();
            assert!(!watch.look() && !watch.look());
        }
        fs::remove_file(&card).unwrap();
        assert!(!watch.look() && !watch.look());
    }

    #[test]
    fn what_cannot_change_is_named_and_the_rest_is_taken() {
        let files = Files::new();
        let path = files.path("robot.yaml");
        let load = |text: &str| {
            fs::write(&path, text).unwrap();
            Loaded::load(&path)
        };
        let text = "{version: 1, identity: id.pem, links: [{to: 'eth://r0'}], graphs: {a: {domain_id: 1}}, topics: [\
                    {topic: /chatter, direction: out, card: t.card, cert: t.ad}]}";
        let loaded = load(text).unwrap();
        let cases = [
            ("eth://r0'}", "eth://r1'}", Some("links")),
            ("topics:", "state: s, topics:", Some("state")),
            ("topics:", "definitions: {ros2: [/opt]}, topics:", Some("definitions")),
            ("domain_id: 1", "domain_id: 2", Some("graphs.a")),
            ("{a: {domain_id: 1}}", "{b: {domain_id: 1}}", Some("graphs.a")),
            ("1}}", "1}, b: {domain_id: 2}}", None),
            ("/chatter", "/chitter", None),
            ("out,", "out, priority: 7,", None),
        ];
        for (from, to, expected) in cases {
            let changed = text
                .replacen(from, to, 1)
                .replace("direction", if to.contains("}, b") { "graph: a, direction" } else { "direction" });
            fs::write(&path, changed).unwrap();
            let refusal = loaded.load_again(&path).err().map(|error| error.to_string());
            match (expected, refusal) {
                (None, None) => {}
                (Some(key), Some(said)) if said.contains(&format!("robot.yaml: {key}: cannot change")) => {}
                (_, refusal) => panic!("{to}: {refusal:?}"),
            }
        }
        gdp::SigningKey::generate().unwrap().save_new(&files.path("other.pem")).unwrap();
        fs::write(&path, text.replace("id.pem", "other.pem")).unwrap();
        let refusal = loaded.load_again(&path).err().unwrap().to_string();
        assert!(refusal.contains("topics[0].cert"), "{refusal}");
    }
}
