//! Sources of renewed certificates of a running topic: a file, or the part of the proxy that issues
//! or learns them.

use std::fmt::Display;

use tokio::sync::watch;

use crate::cert_file::CertFile;
use crate::permission::Permission;

#[derive(Clone)]
pub enum Renewal {
    File(Box<CertFile>),
    Notified(Notified),
}

/// Newest certificate, as another part of the proxy reports it.
#[derive(Clone)]
pub struct Notified {
    newest: watch::Receiver<Permission>,
    /// True if the newest certificate has been offered and is not in force.
    offered: bool,
}

impl Renewal {
    /// Returns a certificate that differs from the one [in force](Self::taken), if any. It is
    /// offered on each call until it is in force.
    pub fn changed(&mut self) -> Option<Permission> {
        match self {
            Self::File(file) => file.changed(),
            Self::Notified(notified) => notified.changed(),
        }
    }

    /// Records that the certificate last offered is in force.
    pub fn taken(&mut self) {
        match self {
            Self::File(file) => file.taken(),
            Self::Notified(notified) => notified.offered = false,
        }
    }

    /// Logs that the certificate last offered cannot be used at the moment.
    pub fn refused(&mut self, reason: &dyn Display) {
        match self {
            Self::File(file) => file.refused(reason),
            Self::Notified(_) => {
                tracing::warn!("a renewed certificate is of no use yet, going on with the old one: {reason}")
            }
        }
    }
}

impl Notified {
    /// Treats the present certificate as in force.
    pub fn new(newest: watch::Receiver<Permission>) -> Self {
        Self { newest, offered: false }
    }

    fn changed(&mut self) -> Option<Permission> {
        self.offered |= self.newest.has_changed().unwrap_or(false);
        self.offered.then(|| self.newest.borrow_and_update().clone())
    }
}

#[cfg(test)]
#[path = "../tests/unit/renewal.rs"]
mod tests;
