//! Statements of a switch's domain, which both switch and domain must sign, and of the addresses of
//! the domain's borders.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

use super::domain::roles;
use super::{Claims, MemberCert, Membership, Revocation, Signed, Validity};
use crate::cert::error::CertError;
use crate::cert::name_proof::MAX_PROOF;
use crate::name::{Name, NameProof};

/// Maximum number of addresses of one switch.
pub const MAX_ADDRESSES: usize = 8;

/// Maximum number of border switches in a locator.
pub const MAX_LOCATED: usize = 8;

/// Maximum bytes of all signed parts in a locator.
pub const MAX_LOCATOR: usize = 24 << 10;

/// Statement of a switch to other domains: its domain and its addresses. The switch signs it with
/// its own key, and its highest serial counts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SwitchStatement {
    pub switch: Name,
    pub domain: Name,
    /// Addresses, best first. Empty if the switch can only dial or is no border.
    pub addresses: Vec<SocketAddr>,
    pub serial: u64,
    /// Last Unix second of validity.
    pub not_after: u64,
}

impl Claims for SwitchStatement {
    const KIND: &'static str = "SwitchStatement";
    const LABEL: &'static str = "GDP SWITCH STATEMENT";
    const CONTEXT: &'static str = "application/vnd.gdp.switch-statement.v2+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: 0, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        let count = self.addresses.len();
        if count > MAX_ADDRESSES {
            return Err(CertError::Malformed(format!("{count} addresses where at most {MAX_ADDRESSES} are allowed")));
        }
        Ok(())
    }
}

/// Switch and its domain, as any other domain can verify them. Without the switch's own statement,
/// a domain could claim any switch and attract the traffic of its entities.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Host {
    /// Proof of the switch's name, which holds its key.
    pub proof: NameProof,
    pub statement: Signed<SwitchStatement>,
    pub membership: Membership,
}

impl Host {
    /// Verifies that both `domain` and the switch state its membership at `now` (Unix seconds).
    /// Returns the certificate and the statement.
    ///
    /// `revocation` is the newest known one of the domain. The returned statement ends with the
    /// first of its parts to expire.
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

    /// Returns whether `other` states the same, apart from the serial.
    pub fn says_the_same(&self, other: &Self) -> bool {
        let claims =
            |host: &Self| host.statement.claims_unverified().ok().map(|claims| SwitchStatement { serial: 0, ..claims });
        let is_same_claim = || claims(self).is_some_and(|own| claims(other).is_some_and(|other| own == other));
        (self.proof, &self.membership) == (other.proof, &other.membership)
            && (self.statement == other.statement || is_same_claim())
    }

    /// Returns the bytes of the signed parts and the maximum size of a proof.
    pub fn size(&self) -> usize {
        self.statement.as_bytes().len() + self.membership.size() + MAX_PROOF
    }
}

/// Locator of a domain: its borders, best first. Receivers skip borders that do not verify, because
/// one border whose membership ended must not hide the others. A locator with too many borders, or
/// with none left, is void.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Locator {
    pub borders: Vec<Host>,
}

impl Locator {
    /// Verifies each border separately, as [`Host::verify`] does, and that its role is that of a
    /// border. Fails if the locator exceeds its limits.
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

    /// Returns the sum of [`Host::size`] of all borders.
    pub fn size(&self) -> usize {
        self.borders.iter().map(Host::size).sum()
    }
}
