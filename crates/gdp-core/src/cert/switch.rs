//! Of which domain a switch is, which both have to say, and where its domain can be reached: at
//! those that are borders.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

use super::domain::roles;
use super::{Claims, MemberCert, Membership, Revocation, Signed, Validity};
use crate::cert::error::CertError;
use crate::cert::name_proof::MAX_PROOF;
use crate::name::{Name, NameProof};

/// Addresses of one switch.
pub const MAX_ADDRESSES: usize = 8;

/// Border switches of one domain that are told of.
pub const MAX_LOCATED: usize = 8;

/// Bytes of all that is signed in a locator.
pub const MAX_LOCATOR: usize = 16 << 10;

/// A switch → other domains: I am of this one, and here you reach me. Signed by its own key; of a
/// switch the highest serial counts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SwitchStatement {
    pub switch: Name,
    pub domain: Name,
    /// Best first. None if it can only dial, or is no border.
    pub addresses: Vec<SocketAddr>,
    pub serial: u64,
    /// The last Unix second at which it holds.
    pub not_after: u64,
}

impl Claims for SwitchStatement {
    const KIND: &'static str = "SwitchStatement";
    const LABEL: &'static str = "GDP SWITCH STATEMENT";
    const CONTEXT: &'static str = "application/vnd.gdp.switch-statement.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: 0, not_after: self.not_after }
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        let count = self.addresses.len();
        if count > MAX_ADDRESSES {
            return Err(CertError::Malformed(format!("{count} addresses where at most {MAX_ADDRESSES} are allowed")));
        }
        Ok(())
    }
}

/// A switch and its domain, as any other domain may judge them. A domain alone could say of any
/// switch that it is its own, and draw what is for the entities there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Host {
    /// How the name of the switch is derived, and its key.
    pub proof: NameProof,
    pub statement: Signed<SwitchStatement>,
    pub membership: Membership,
}

impl Host {
    /// What `domain` and the switch say of it, if both say that it is a switch of `domain` at `now`
    /// (Unix seconds). `revocation` is the newest that is known of the domain. The statement that
    /// is returned ends with all that it rests on.
    pub fn verify(
        &self,
        domain: Name,
        revocation: Option<&Revocation>,
        now: u64,
    ) -> Result<(MemberCert, SwitchStatement), CertError> {
        let member = self.membership.verify(domain, revocation, now)?;
        if !roles::is_switch(&member.role) {
            return Err(CertError::WrongRole { expected: roles::SWITCH.into(), got: member.role });
        }
        let switch = self.proof.name()?;
        if member.entity != switch {
            return Err(CertError::WrongEntity { expected: switch, got: member.entity });
        }
        let mut claims = self.statement.verify(&self.proof.verify_key()?, now)?;
        if claims.switch != switch {
            return Err(CertError::WrongSwitch { expected: switch, got: claims.switch });
        }
        if claims.domain != domain {
            return Err(CertError::WrongDomain { expected: domain, got: claims.domain });
        }
        claims.not_after = claims.not_after.min(member.not_after);
        Ok((member, claims))
    }

    /// Whether `other` says nothing else, whenever it was stated.
    pub fn says_the_same(&self, other: &Self) -> bool {
        let claims =
            |host: &Self| host.statement.claims_unverified().ok().map(|claims| SwitchStatement { serial: 0, ..claims });
        let is_same_claim = || claims(self).is_some_and(|own| claims(other).is_some_and(|other| own == other));
        (self.proof, &self.membership) == (other.proof, &other.membership)
            && (self.statement == other.statement || is_same_claim())
    }

    /// Bytes of what is signed in it, and of the proof.
    pub fn size(&self) -> usize {
        self.statement.as_bytes().len() + self.membership.size() + MAX_PROOF
    }
}

/// Where a domain can be reached: its borders, best first. Each stands for itself: whoever receives
/// it leaves out those that do not verify, because one border whose membership is over must not
/// hide the others. One that names too many, or of which none is left, says nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Locator {
    pub borders: Vec<Host>,
}

impl Locator {
    /// As [`Host::verify`], of each by itself, which must be a border. The error: they are more
    /// than allowed.
    pub fn verify(
        &self,
        domain: Name,
        revocation: Option<&Revocation>,
        now: u64,
    ) -> Result<Vec<Result<SwitchStatement, CertError>>, CertError> {
        let (count, size) = (self.borders.len(), self.size());
        if count > MAX_LOCATED || size > MAX_LOCATOR {
            return Err(CertError::Malformed(format!(
                "{count} borders, {size} bytes in all, where {MAX_LOCATED} and {MAX_LOCATOR} are allowed"
            )));
        }
        let statements = self.borders.iter().map(|border| match border.verify(domain, revocation, now)? {
            (member, statement) if member.role == roles::BORDER => Ok(statement),
            (member, _) => Err(CertError::WrongRole { expected: roles::BORDER.into(), got: member.role }),
        });
        Ok(statements.collect())
    }

    /// As [`Host::size`], of all.
    pub fn size(&self) -> usize {
        self.borders.iter().map(Host::size).sum()
    }
}
