//! Files that hold an entity's [`Credentials`].

use std::io;
use std::path::{Path, PathBuf};

use gdp_util::text_file;

use super::Credentials;
use crate::card::{CardError, NameCard};
use crate::cert::{CertError, MAX_CERT_FILE, Membership, Signed};

#[derive(Debug, thiserror::Error)]
pub enum PaperFileError {
    #[error(transparent)]
    Card(#[from] CardError),
    #[error("{}: cannot be read: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{}: not the card of a domain; name the file domain.card of the domain", .0.display())]
    NotADomain(PathBuf),
    #[error("{}: {source}", path.display())]
    Cert { path: PathBuf, source: CertError },
}

/// Paths of the files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CredentialFiles {
    /// Card of the domain.
    pub card: PathBuf,
    pub membership: PathBuf,
    /// Certificates of the domain for other domains, one per file.
    pub peers: Vec<PathBuf>,
}

impl CredentialFiles {
    /// Reads the files. Checks that they belong together, but not that they are valid.
    pub fn load(&self) -> Result<Credentials, PaperFileError> {
        let card = NameCard::load(&self.card)?;
        if !card.is_domain() {
            return Err(PaperFileError::NotADomain(self.card.clone()));
        }
        let domain = card.proof();
        let membership = read(&self.membership, Membership::from_pem)?;
        if membership.domain != domain {
            let wrong = |source| PaperFileError::Cert { path: self.membership.clone(), source };
            let expected = domain.name().map_err(|error| wrong(error.into()))?;
            let got = membership.domain.name().map_err(|error| wrong(error.into()))?;
            return Err(wrong(CertError::WrongDomain { expected, got }));
        }
        let peers = self.peers.iter().map(|path| read(path, Signed::from_pem)).collect::<Result<_, _>>()?;
        let credentials = Credentials { membership, peers };
        credentials.check_bounds().map_err(|source| PaperFileError::Cert { path: self.membership.clone(), source })?;
        Ok(credentials)
    }

    /// Returns all paths, to be watched for changes.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        [&self.card, &self.membership].into_iter().chain(&self.peers).map(PathBuf::as_path)
    }
}

fn read<T>(path: &Path, parse: impl Fn(&str) -> Result<T, CertError>) -> Result<T, PaperFileError> {
    let io = |source| PaperFileError::Io { path: path.into(), source };
    let cert = |source| PaperFileError::Cert { path: path.into(), source };
    let text = text_file::read(path, MAX_CERT_FILE as u64).map_err(io)?;
    let too_long = || cert(CertError::Malformed(format!("longer than {MAX_CERT_FILE} bytes")));
    parse(&text.ok_or_else(too_long)?).map_err(cert)
}
