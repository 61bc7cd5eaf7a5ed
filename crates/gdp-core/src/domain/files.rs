//! The files that an entity's [`Credentials`] are in.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use super::Credentials;
use crate::card::{CardError, NameCard};
use crate::cert::{CertError, MAX_CERT_FILE, Membership, Signed};

#[derive(Debug, thiserror::Error)]
pub enum PaperFileError {
    #[error(transparent)]
    Card(#[from] CardError),
    #[error("{}: cannot be read: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{}: {source}", path.display())]
    Cert { path: PathBuf, source: CertError },
}

/// Where they are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CredentialFiles {
    /// The domain's card.
    pub card: PathBuf,
    pub membership: PathBuf,
    /// What the domain lets others do, a certificate to a file.
    pub peers: Vec<PathBuf>,
}

impl CredentialFiles {
    /// Reads them; whether they are of each other is checked, not whether they hold.
    pub fn load(&self) -> Result<Credentials, PaperFileError> {
        let domain = NameCard::load(&self.card)?.proof();
        let membership = read(&self.membership, Membership::from_pem)?;
        if membership.domain != domain {
            let wrong = |source| PaperFileError::Cert { path: self.membership.clone(), source };
            let expected = domain.name().map_err(|error| wrong(error.into()))?;
            let got = membership.domain.name().map_err(|error| wrong(error.into()))?;
            return Err(wrong(CertError::WrongDomain { expected, got }));
        }
        let peers = self.peers.iter().map(|path| read(path, Signed::from_pem)).collect::<Result<_, _>>()?;
        let papers = Credentials { membership, peers };
        papers.check_bounds().map_err(|source| PaperFileError::Cert { path: self.membership.clone(), source })?;
        Ok(papers)
    }

    /// All of them, to be watched: the papers are others when one is.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        [&self.card, &self.membership].into_iter().chain(&self.peers).map(PathBuf::as_path)
    }
}

fn read<T>(path: &Path, parse: impl Fn(&str) -> Result<T, CertError>) -> Result<T, PaperFileError> {
    let io = |source| PaperFileError::Io { path: path.into(), source };
    let mut text = String::new();
    File::open(path).map_err(io)?.take(MAX_CERT_FILE as u64 + 1).read_to_string(&mut text).map_err(io)?;
    parse(&text).map_err(|source| PaperFileError::Cert { path: path.into(), source })
}
