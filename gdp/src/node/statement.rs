//! A statement of this node about a name: that it publishes, reads, serves or calls it, and the
//! right to do so.

use gdp_wire::Name;

use gdp_core::cert::{AdCert, CertError, Issued, Reading as Grant, Revocation};
use gdp_core::name::NameProof;
use gdp_proto::control::NameRole;

/// The kinds of statements about a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stated {
    Published,
    Subscribed,
    Served,
    Called,
}

impl Stated {
    pub const ALL: [Self; 4] = [Self::Published, Self::Subscribed, Self::Served, Self::Called];

    pub fn role(self) -> NameRole {
        match self {
            Self::Published => NameRole::Publisher,
            Self::Subscribed => NameRole::Subscriber,
            Self::Served => NameRole::Server,
            Self::Called => NameRole::Caller,
        }
    }

    /// Returns whether the statement concerns frames that the node sends, on any of its links.
    /// These go to the name itself or to its servers.
    pub fn sends(self) -> bool {
        matches!(self, Self::Published | Self::Called)
    }

    pub fn of(role: NameRole) -> Self {
        match role {
            NameRole::Publisher => Self::Published,
            NameRole::Subscriber => Self::Subscribed,
            NameRole::Server => Self::Served,
            NameRole::Caller => Self::Called,
        }
    }
}

impl std::fmt::Display for Stated {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Published => "published",
            Self::Subscribed => "subscribed to",
            Self::Served => "served",
            Self::Called => "called",
        })
    }
}

/// The right to a name, as presented to the RIB.
#[derive(Clone, PartialEq, Eq)]
pub enum Statement {
    /// A right to publish or serve.
    Write { proof: NameProof, ad_cert: Issued<AdCert> },
    /// A right to subscribe or call.
    Read { proof: NameProof, grant: Grant },
}

/// A statement that the application wants to maintain.
pub struct Advertisement {
    pub statement: Statement,
    /// The expiry of the right, in Unix seconds.
    pub not_after: u64,
    /// Whether its frames use two links.
    pub duplicate: bool,
    /// A bit for each lane whose current link has carried the statement.
    pub done: u8,
    /// Whether the right has ended.
    pub over: bool,
}

impl Statement {
    /// Returns the name and the expiry of the right (Unix seconds), if the right is valid for this
    /// entity.
    pub fn verify(&self, entity: Name, revocation: Option<&Revocation>, now: u64) -> Result<(Name, u64), CertError> {
        match self {
            Self::Write { proof, ad_cert } => {
                let claims = ad_cert.verify(proof, revocation, now)?;
                if claims.entity != entity {
                    return Err(CertError::WrongEntity { expected: entity, got: claims.entity });
                }
                Ok((claims.name, claims.not_after))
            }
            Self::Read { proof, grant } => {
                let claims = grant.verify(proof, entity, revocation, now)?;
                Ok((claims.name, claims.not_after))
            }
        }
    }

    pub fn proof(&self) -> &NameProof {
        match self {
            Self::Write { proof, .. } | Self::Read { proof, .. } => proof,
        }
    }
}
