//! A topic's certificate, which may be replaced while the proxy runs: read again when its file changes.

use std::path::PathBuf;
use std::time::SystemTime;

use gdp::{Name, NameCard};

use crate::config::TopicConfig;
use crate::material::{Permission, load_permission};

pub struct CertFile {
    topic: TopicConfig,
    card: NameCard,
    entity: Name,
    /// Of the file as it was looked at last.
    seen: Option<Stamp>,
}

/// Another file, or another content, has another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stamp {
    modified: SystemTime,
    inode: u64,
    length: u64,
}

impl CertFile {
    pub fn new(topic: &TopicConfig, card: &NameCard, entity: Name) -> Self {
        let mut file = Self { topic: topic.clone(), card: card.clone(), entity, seen: None };
        file.seen = file.stamp();
        file
    }

    pub fn path(&self) -> &PathBuf {
        &self.topic.cert
    }

    /// What it holds now, if it has changed since it was looked at last; the error says what is wrong with it.
    pub fn changed(&mut self) -> Option<Result<Permission, String>> {
        let stamp = self.stamp();
        // Gone: about to be replaced, perhaps.
        if stamp.is_none() || stamp == self.seen {
            return None;
        }
        self.seen = stamp;
        Some(load_permission(&self.topic, &self.card, self.entity))
    }

    fn stamp(&self) -> Option<Stamp> {
        use std::os::unix::fs::MetadataExt;
        let metadata = std::fs::metadata(&self.topic.cert).ok()?;
        Some(Stamp { modified: metadata.modified().ok()?, inode: metadata.ino(), length: metadata.len() })
    }
}

#[cfg(test)]
mod tests {
    use gdp::cert::{AdCert, issue};

    use super::*;
    use crate::material::tests::Files;

    #[test]
    fn a_certificate_is_read_again_when_it_is_another_and_only_then() {
        let files = Files::new();
        let topic = &files.config("").topics[0];
        let mut file = CertFile::new(topic, &files.card, files.entity);
        assert!(file.changed().is_none());
        let write = |name: &str, serial| {
            let text = issue(&files.owner, &AdCert { serial, ..files.claims() }).unwrap().to_pem();
            std::fs::write(files.path(name), text).unwrap();
        };
        // As tools do it that replace files.
        write("new", 7);
        std::fs::rename(files.path("new"), files.path("t.ad")).unwrap();
        let cert = file.changed().expect("changed").unwrap().publish().unwrap();
        assert_eq!(cert.serials().unwrap()[0].1, 7);
        assert!(file.changed().is_none());
        std::fs::remove_file(files.path("t.ad")).unwrap();
        assert!(file.changed().is_none());
        std::fs::write(files.path("t.ad"), "half").unwrap();
        assert!(file.changed().expect("changed").is_err());
        write("t.ad", 8);
        assert!(file.changed().expect("changed").is_ok());
    }
}
