//! Reasons why a RIB refuses an announcement of a neighbouring domain.

use gdp_core::cert::CertError;
use gdp_proto::control::MAX_PATH;
use gdp_wire::Name;

/// Reason why an announcement of a neighbouring domain is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TierRefusal {
    #[error("a path of {0} domains, where 1 to {MAX_PATH} are allowed")]
    PathLength(usize),
    #[error("a path that ends in domain {got:#}, from domain {from:#}: a domain speaks for itself only")]
    NotItsOwn { from: Name, got: Name },
    #[error("a cycle: it came through domain {0:#} before")]
    Cycle(Name),
    #[error("the record of {name:#}: {source}")]
    Record { name: Name, source: Box<CertError> },
    #[error("that switch {switch:#} is of domain {domain:#}, which both have to say: {source}")]
    Host { switch: Name, domain: Name, source: Box<CertError> },
    #[error(
        "the writer of {name:#} may be known in its own domain {origin:#} only: have its AdCert issued with the \
         other domains in its scope"
    )]
    OutOfScope { name: Name, origin: Name },
    #[error("the record of {0:#} has ended")]
    Ended(Name),
    #[error("a key box of {0:#}, of which no part in a name is known")]
    NoWriter(Name),
    #[error("a key box of {writer:#}: {source}")]
    Box { writer: Name, source: Box<CertError> },
    #[error("the locator of domain {domain:#}: {source}")]
    Locator { domain: Name, source: Box<CertError> },
    #[error(
        "the locator of domain {0:#} names no border switch: who can be reached nowhere is to take its locator back"
    )]
    Nowhere(Name),
    #[error("domain {0:#} says what was taken back where it is to say who has a part in a name")]
    Misplaced(Name),
    #[error("what the owner of {name:#} is said to have taken back: {source}")]
    Revocation { name: Name, source: Box<CertError> },
    #[error("{limit} {what} of one domain are kept: that is the limit of this RIB")]
    Full { what: &'static str, limit: usize },
    #[error("{limit} parts in {name:#} of one domain are kept: that is the limit of this RIB")]
    NameFull { name: Name, limit: usize },
}

impl TierRefusal {
    /// Returns the name whose owner has revoked the refused record, if that is the reason.
    pub fn revoked(&self) -> Option<Name> {
        match self {
            Self::Record { name, source } if matches!(**source, CertError::Revoked { .. }) => Some(*name),
            _ => None,
        }
    }

    /// Returns the label of the refusal's counter.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::PathLength(_) => "path_length",
            Self::NotItsOwn { .. } => "not_its_own",
            Self::Cycle(_) => "cycle",
            Self::OutOfScope { .. } => "scope",
            Self::Ended(_) => "ended",
            Self::NoWriter(_) => "no_writer",
            Self::Nowhere(_) => "nowhere",
            Self::Misplaced(_) => "misplaced",
            Self::Full { .. } => "limit",
            Self::NameFull { .. } => "name_limit",
            Self::Record { source, .. }
            | Self::Host { source, .. }
            | Self::Box { source, .. }
            | Self::Revocation { source, .. }
            | Self::Locator { source, .. } => match **source {
                CertError::BadSignature { .. } | CertError::HighS { .. } | CertError::WrongKey { .. } => "signature",
                CertError::NotYetValid { .. } | CertError::IssuedLater { .. } => "not_yet_valid",
                CertError::Expired { .. } => "expired",
                CertError::Revoked { .. } => "revoked",
                CertError::WrongDomain { .. } => "wrong_domain",
                CertError::ReplayedSerial { .. } => "replayed",
                _ => "certificate",
            },
        }
    }
}
