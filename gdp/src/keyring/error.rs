//! Errors of keyrings and of names in them.

use std::fmt;
use std::path::PathBuf;

use gdp_core::cert::CertError;
use gdp_wire::Name;

/// Why a keyring cannot be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyringError {
    /// The folder cannot be listed.
    #[error(
        "no keyring at {}: {source}; make the folder and put name cards, grants and your key id.pem there, or say \
         where they are with GDP_KEYRING or --keyring", path.display()
    )]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The folder has too many entries.
    #[error("{} has more than {most} entries; keep name cards and grants in a folder of their own", path.display())]
    TooMany {
        /// The folder.
        path: PathBuf,
        /// How many are allowed.
        most: usize,
    },
    /// Neither the environment nor the user's home says where the folder is.
    #[error("no place for a keyring: say where it is with GDP_KEYRING or --keyring, or set HOME")]
    Unset,
    /// The configuration that `join` wrote names no link to a switch.
    #[error("{}: no link to the switch: {reason}; give one with GDP_SWITCH or --switch", path.display())]
    Links {
        /// The configuration file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

/// Why a search finds no single card.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FindError {
    /// There is no such card.
    #[error("no name card of a {kind} {what} in {}; `gdp-ctl {kind} list` shows those there are", folder.display())]
    Unknown {
        /// What was searched for.
        what: String,
        /// `topic`, `service` or `action`.
        kind: String,
        /// The keyring.
        folder: PathBuf,
    },
    /// Several names match.
    #[error("{what} is the {kind} of several names: {}; give the name itself, or its first digits", NameList(names))]
    Ambiguous {
        /// What was searched for.
        what: String,
        /// `topic`, `service` or `action`.
        kind: String,
        /// The names that match.
        names: Vec<Name>,
    },
    /// The name is of another kind.
    #[error("{what} is a {got}, and no {kind}")]
    Other {
        /// What was searched for.
        what: String,
        /// The kind that was searched for.
        kind: String,
        /// The kind of the card.
        got: String,
    },
}

/// Why there is no valid certificate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RightError {
    /// The keyring has none for this name and entity.
    #[error(transparent)]
    Missing(Box<MissingRight>),
    /// The keyring has one that does not hold.
    #[error("{}: {source}; have the owner of {of} issue another one", file.display())]
    Refused {
        /// The certificate's file.
        file: PathBuf,
        /// The ROS name.
        of: String,
        /// Why it does not hold.
        source: Box<CertError>,
    },
}

/// A certificate that the keyring does not have.
#[derive(Debug, thiserror::Error)]
#[error(
    "no {what} for {of} ({name:#}) in {}; have its owner run `gdp-ctl grant add CARD --key OWNER.pem {option} \
     --entity {entity} -o FILE.{ending}`, \
     and put the file there",
    folder.display()
)]
pub struct MissingRight {
    pub(super) what: &'static str,
    pub(super) option: &'static str,
    pub(super) ending: &'static str,
    pub(super) of: String,
    pub(super) name: Name,
    pub(super) entity: Name,
    pub(super) folder: PathBuf,
}

struct NameList<'a>(&'a [Name]);

impl fmt::Display for NameList<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "))
    }
}
