//! A topic's certificate, which may be replaced while the proxy runs: read again when its file changes, until what it holds is in
//! force.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use gdp_core::card::NameCard;
use gdp_core::file_stamp::FileStamp;
use gdp_wire::Name;

use crate::config::Side;
use crate::material::{Permission, load_permission};

#[derive(Clone)]
pub struct CertFile {
    path: PathBuf,
    side: Side,
    topic: String,
    card: NameCard,
    entity: Name,
    /// Of the file whose content is in force, of the one that was offered last, and of the one that the log has told of.
    taken: Option<FileStamp>,
    offered: Option<FileStamp>,
    told: Option<FileStamp>,
}

impl CertFile {
    /// What it holds now is in force.
    pub fn open(
        path: &Path,
        side: Side,
        topic: &str,
        card: &NameCard,
        entity: Name,
    ) -> Result<(Self, Permission), String> {
        let (path, topic, card) = (path.to_owned(), topic.to_owned(), card.clone());
        let mut file = Self { path, side, topic, card, entity, taken: None, offered: None, told: None };
        let permission = file.read()?;
        file.taken();
        Ok((file, permission))
    }

    /// What it holds now, if it does for the topic and was not [taken](Self::taken) yet. Until it is, it is offered each time: the RIB
    /// may be away, and the clock may be behind.
    pub fn changed(&mut self) -> Option<Permission> {
        // Gone: about to be replaced, perhaps.
        let stamp = Some(self.stamp()?);
        if stamp == self.taken {
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
        if self.told != self.offered {
            let (topic, file) = (&self.topic, self.path.display());
            tracing::warn!(%topic, %file, "the new certificate is of no use yet, going on with the old one: {reason}");
            self.told = self.offered;
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
mod tests {
    use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

    use gdp_core::cert::{AdCert, CLOCKS_DIFFER, issue};

    use super::*;
    use crate::material::Material;
    use crate::material::tests::Files;

    #[test]
    fn a_certificate_is_read_again_when_it_is_another_and_only_then() {
        let (files, mut file) = opened();
        assert!(file.changed().is_none());
        // As tools do it that replace files.
        write(&files, "new", AdCert { serial: 7, ..files.claims() });
        std::fs::rename(files.path("new"), files.path("t.ad")).unwrap();
        assert_eq!(serial(file.changed()), Some(7));
        file.taken();
        assert!(file.changed().is_none());
        std::fs::remove_file(files.path("t.ad")).unwrap();
        assert!(file.changed().is_none());
        std::fs::write(files.path("t.ad"), "half").unwrap();
        assert!(file.changed().is_none());
        write(&files, "t.ad", AdCert { serial: 8, ..files.claims() });
        assert_eq!(serial(file.changed()), Some(8));
    }

    #[test]
    fn what_is_not_taken_is_offered_again() {
        let (files, mut file) = opened();
        write(&files, "t.ad", AdCert { serial: 7, ..files.claims() });
        for _ in 0..3 {
            assert_eq!(serial(file.changed()), Some(7));
            file.refused(&"the RIB is away");
        }
        file.taken();
        assert!(file.changed().is_none());
    }

    #[test]
    fn a_certificate_that_is_not_valid_yet_is_offered_once_it_is() {
        let (files, mut file) = opened();
        let not_before = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs() + CLOCKS_DIFFER + 2;
        write(&files, "t.ad", AdCert { serial: 7, not_before, ..files.claims() });
        assert!(file.changed().is_none());
        let deadline = Instant::now() + Duration::from_secs(10);
        while serial(file.changed()) != Some(7) {
            assert!(Instant::now() < deadline, "not in time");
        }
    }

    #[test]
    fn what_is_replaced_after_the_start_is_noticed_though_it_was_not_looked_for() {
        let files = Files::new();
        let mut material = Material::load(&files.config("")).unwrap();
        write(&files, "t.ad", AdCert { serial: 7, ..files.claims() });
        assert_eq!(serial(material.routes[0].1.file.changed()), Some(7));
    }

    fn opened() -> (Files, CertFile) {
        let files = Files::new();
        let (file, _) = CertFile::open(&files.path("t.ad"), Side::Out, "/chatter", &files.card, files.entity).unwrap();
        (files, file)
    }

    fn write(files: &Files, name: &str, claims: AdCert) {
        std::fs::write(files.path(name), issue(&files.owner, &claims).unwrap().to_pem()).unwrap();
    }

    fn serial(permission: Option<Permission>) -> Option<u64> {
        Some(permission?.publish().unwrap().serials().unwrap()[0].1)
    }
}
