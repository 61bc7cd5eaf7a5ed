//! Errors of a session.

use std::path::PathBuf;
use std::time::Duration;

use gdp_core::domain::PaperFileError;
use gdp_core::link_target::LinkTargetError;
use gdp_core::secret_file::SecretFileError;

use crate::keyring::members::MembersError;
use crate::keyring::{FindError, KeyringError, RightError};
use crate::node::{Ended, NodeError, Unflushed};

/// Why a session or one of its handles failed. The text names the thing and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// `GDP_SWITCH` is no link.
    #[error("GDP_SWITCH: {0}")]
    Switch(#[from] LinkTargetError),
    /// The keyring cannot be used.
    #[error(transparent)]
    Keyring(#[from] KeyringError),
    /// The private key cannot be used.
    #[error("{source}; make a key with `gdp-ctl key generate {} --kind proxy`, or join a domain", file.display())]
    Key {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        source: SecretFileError,
    },
    /// The proof of membership in the domain cannot be used.
    #[error(transparent)]
    Credentials(#[from] PaperFileError),
    /// The keyring has no such name.
    #[error(transparent)]
    Find(#[from] FindError),
    /// No other member of the domain shares such a name.
    #[error(transparent)]
    Members(Box<MembersError>),
    /// There is no certificate for this entity, or it does not hold.
    #[error(transparent)]
    Right(#[from] RightError),
    /// The fabric refused, or there is no link to it.
    #[error(transparent)]
    Fabric(#[from] NodeError),
    /// The right ended, or the session was closed.
    #[error(transparent)]
    Ended(#[from] Ended),
    /// The server did not answer a call.
    #[error("{name} did not reply in {} s; the request may have been carried out", after.as_secs_f64())]
    NoReply {
        /// The service, as the program named it.
        name: String,
        /// How long the call waited.
        after: Duration,
    },
    /// No server attached while a call waited for one. The request was not sent.
    #[error("no server of {name} attached in {} s; is it running? Nothing was sent", after.as_secs_f64())]
    NoServer {
        /// The service, as the program named it.
        name: String,
        /// How long the call waited.
        after: Duration,
    },
    /// Not every reader has acknowledged what was published.
    #[error("{name}: {source}")]
    Unflushed {
        /// The name, as the program named it.
        name: String,
        /// What is missing.
        source: Unflushed,
    },
}

impl From<MembersError> for Error {
    fn from(error: MembersError) -> Self {
        Self::Members(error.into())
    }
}

impl Error {
    /// Returns whether a later attempt may succeed without a change of files.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Fabric(error) => error.may_pass(),
            Self::Members(error) => match &**error {
                MembersError::Node(error) => error.may_pass(),
                error => matches!(error, MembersError::DirectorySilent | MembersError::CatalogSilent { .. }),
            },
            Self::NoReply { .. } | Self::NoServer { .. } | Self::Unflushed { .. } => true,
            _ => false,
        }
    }
}
