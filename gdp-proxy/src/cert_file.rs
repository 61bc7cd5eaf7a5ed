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
    /// True if the file has changed and its content is perhaps not in force.
    is_pending: bool,
    side: Side,
    topic: String,
    card: NameCard,
    entity: Name,
    /// Stamp of the file whose content is in force.
    taken: Option<FileStamp>,
    /// Stamp of the file last offered.
    offered: Option<FileStamp>,
    /// Stamp of the file last reported in the log.
    reported: Option<FileStamp>,
}

impl CertFile {
    /// Opens the file and treats its present content as in force.
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

    /// Returns the file's content, if it is valid for the topic and is not [in force](Self::taken)
    /// yet. The content is offered on each call until then, because the RIB may be unreachable or
    /// the clock may be slow.
    pub fn changed(&mut self) -> Option<Permission> {
        self.is_pending |= self.watched.has_changed();
        if !self.is_pending {
            return None;
        }
        // The file is missing, perhaps because it is about to be replaced.
        let stamp = Some(self.stamp()?);
        self.is_pending = stamp != self.taken;
        if !self.is_pending {
            return None;
        }
        self.read().map_err(|reason| self.refused(&reason)).ok()
    }

    /// Records that the content last offered is in force.
    pub fn taken(&mut self) {
        self.taken = self.offered;
    }

    /// Logs, once for each content, that the content last offered cannot be used at the moment.
    pub fn refused(&mut self, reason: &dyn Display) {
        if self.reported != self.offered {
            let (topic, file) = (&self.topic, self.path.display());
            tracing::warn!(%topic, %file, "the new certificate is of no use yet, going on with the old one: {reason}");
            self.reported = self.offered;
        }
    }

    /// Reads the file. It reads the stamp first, so that a file that replaces it meanwhile has
    /// another stamp.
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
