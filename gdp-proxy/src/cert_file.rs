//! The certificate file of a topic. The proxy reads it again when it changes, until the new
//! certificate is in force.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use gdp_core::card::NameCard;
use gdp_util::file_watch::{FileStamp, FileWatcher, WatchedFile};
use gdp_wire::Name;

use crate::config::Side;
use crate::permission::{Permission, load_permission};

#[derive(Clone)]
pub struct CertFile {
    path: PathBuf,
    watched: WatchedFile,
    /// It has changed, and what it holds is perhaps not in force.
    is_pending: bool,
    side: Side,
    topic: String,
    card: NameCard,
    entity: Name,
    /// Of the file whose content is in force, of the one that was offered last, and of the one that
    /// the log has told of.
    taken: Option<FileStamp>,
    offered: Option<FileStamp>,
    reported: Option<FileStamp>,
}

impl CertFile {
    /// What it holds now is in force.
    pub fn open(
        path: &Path,
        side: Side,
        topic: &str,
        card: &NameCard,
        entity: Name,
        watcher: &FileWatcher,
    ) -> Result<(Self, Permission), String> {
        let (watched, is_pending) = (watcher.watch(path), false);
        let (path, topic, card) = (path.to_owned(), topic.to_owned(), card.clone());
        let (taken, offered, reported) = (None, None, None);
        let mut file = Self { path, watched, is_pending, side, topic, card, entity, taken, offered, reported };
        let permission = file.read()?;
        file.taken();
        Ok((file, permission))
    }

    /// What it holds now, if it does for the topic and was not [taken](Self::taken) yet. Until it
    /// is, it is offered each time: the RIB may be away, and the clock may be behind.
    pub fn changed(&mut self) -> Option<Permission> {
        self.is_pending |= self.watched.has_changed();
        if !self.is_pending {
            return None;
        }
        // Gone: about to be replaced, perhaps.
        let stamp = Some(self.stamp()?);
        self.is_pending = stamp != self.taken;
        if !self.is_pending {
            return None;
        }
        self.read().map_err(|reason| self.refused(&reason)).ok()
    }

    /// What was offered last is in force.
    pub fn taken(&mut self) {
        self.taken = self.offered;
    }

    /// What was offered last is of no use at the moment: said once in the log.
    pub fn refused(&mut self, reason: &dyn Display) {
        if self.reported != self.offered {
            let (topic, file) = (&self.topic, self.path.display());
            tracing::warn!(%topic, %file, "the new certificate is of no use yet, going on with the old one: {reason}");
            self.reported = self.offered;
        }
    }

    /// Its stamp is taken first: what replaces it meanwhile has another.
    fn read(&mut self) -> Result<Permission, String> {
        self.offered = self.stamp();
        load_permission(&self.path, self.side, &self.card, self.entity)
    }

    fn stamp(&self) -> Option<FileStamp> {
        FileStamp::of(&self.path)
    }
}

#[cfg(test)]
#[path = "../tests/unit/cert_file.rs"]
mod tests;
