//! Certificates that the owner of a name issues: rights to write and to read it, delegations, and
//! revocations.
//!
//! Every certificate has a serial: the Unix time of its issue in nanoseconds. An owner and its
//! delegates thus need not agree on serials, and a revocation's floor means "nothing issued before
//! then".

use super::{Claims, Signed, Validity};
use crate::cert::error::CertError;
use crate::name::{Name, NameProof};
use crate::verify_key::VerifyKey;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Maximum number of domains in the scope of a name.
pub const MAX_SCOPE: usize = 64;

/// Maximum number of serials that a revocation lists besides its floor.
pub const MAX_REVOKED: usize = 256;

/// Maximum length of a role's name in bytes.
pub const MAX_ROLE: usize = 32;

/// Certificate about a name, issued by its owner or a delegate.
pub trait AboutName: Claims {
    fn name(&self) -> Name;
    fn serial(&self) -> u64;
    /// Returns whether this delegation permits issuing such a certificate.
    fn is_delegated(delegation: &Delegation) -> bool;
    fn set_validity(&mut self, validity: Validity);
}

/// Certificate of a name's owner that an entity may publish or serve the name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdCert {
    pub name: Name,
    pub entity: Name,
    /// Domains in which the name may be known. If empty, only the domain in which it is advertised.
    pub scope: Vec<Name>,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
}

impl Claims for AdCert {
    const KIND: &'static str = "AdCert";
    const LABEL: &'static str = "GDP AD CERT";
    const CONTEXT: &'static str = "application/vnd.gdp.ad-cert.v2+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        if self.scope.len() > MAX_SCOPE {
            return Err(CertError::Malformed(format!(
                "scope of {} domains where at most {MAX_SCOPE} are allowed",
                self.scope.len()
            )));
        }
        self.validity().check_order()
    }
}

impl AboutName for AdCert {
    fn name(&self) -> Name {
        self.name
    }

    fn serial(&self) -> u64 {
        self.serial
    }

    fn is_delegated(delegation: &Delegation) -> bool {
        delegation.publish
    }

    fn set_validity(&mut self, Validity { not_before, not_after }: Validity) {
        (self.not_before, self.not_after) = (not_before, not_after);
    }
}

/// Grant by a name's owner to an entity, or to a role of a domain, to subscribe to or call the
/// name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReadGrant {
    pub name: Name,
    pub to: Grantee,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
}

/// Receiver of a grant.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Grantee {
    Entity(Name),
    /// Every entity to which the domain certifies this role: 1 to 32 bytes of `a-z`, `0-9`, `_` and
    /// `-`.
    Role {
        domain: Name,
        role: String,
    },
}

impl fmt::Display for Grantee {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Entity(entity) => write!(f, "{entity}"),
            Self::Role { domain, role } => write!(f, "role {role} of domain {domain}"),
        }
    }
}

impl Claims for ReadGrant {
    const KIND: &'static str = "ReadGrant";
    const LABEL: &'static str = "GDP READ GRANT";
    const CONTEXT: &'static str = "application/vnd.gdp.read-grant.v2+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        if let Grantee::Role { role, .. } = &self.to {
            check_role(role)?;
        }
        self.validity().check_order()
    }
}

impl AboutName for ReadGrant {
    fn name(&self) -> Name {
        self.name
    }

    fn serial(&self) -> u64 {
        self.serial
    }

    fn is_delegated(delegation: &Delegation) -> bool {
        delegation.read
    }

    fn set_validity(&mut self, Validity { not_before, not_after }: Validity) {
        (self.not_before, self.not_after) = (not_before, not_after);
    }
}

/// Delegation by a name's owner: another key may issue AdCerts (`publish`) or ReadGrants (`read`)
/// for the name. It cannot be delegated further.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Delegation {
    pub name: Name,
    pub delegate: VerifyKey,
    pub publish: bool,
    pub read: bool,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
}

impl Claims for Delegation {
    const KIND: &'static str = "Delegation";
    const LABEL: &'static str = "GDP DELEGATION";
    const CONTEXT: &'static str = "application/vnd.gdp.delegation.v2+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }
}

/// Revocation by a name's owner of all certificates with a serial below `floor` or in `revoked`.
///
/// Of two revocations the one with the higher number counts. No delegate can issue one. The
/// certificates of a domain are revoked by a revocation of the domain's own name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Revocation {
    pub name: Name,
    pub number: u64,
    pub floor: u64,
    /// Revoked serials in ascending order, at most [`MAX_REVOKED`].
    pub revoked: Vec<u64>,
    /// The only key whose certificates hold, if the successor of a domain's key has replaced it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signer: Option<VerifyKey>,
}

impl Revocation {
    /// Checks that a certificate of this kind and serial is not revoked.
    pub fn check(&self, what: &'static str, serial: u64) -> Result<(), CertError> {
        if serial < self.floor || self.revoked.binary_search(&serial).is_ok() {
            return Err(CertError::Revoked { what, serial, floor: self.floor, number: self.number });
        }
        Ok(())
    }

    /// Checks that the domain's certificates by the key of `signed` still hold.
    pub fn check_signer<T: Claims>(&self, signed: &Signed<T>) -> Result<(), CertError> {
        match self.signer {
            Some(signer) if signed.signer_unverified()? != signer => {
                Err(CertError::Retired { what: T::KIND, signer: signer.to_string() })
            }
            _ => Ok(()),
        }
    }

    /// Checks that this revocation may replace `held`. The same one may; an older one, or a
    /// different one with the same number, may not. One that retires the first key of a domain
    /// replaces any that does not, because a thief of that key may have used a high number.
    pub fn check_replaces(&self, held: Option<&Self>) -> Result<(), CertError> {
        match held {
            Some(held) if self.signer.is_some() && held.signer.is_none() => Ok(()),
            Some(held) if self.number < held.number || self.number == held.number && self != held => {
                Err(CertError::RolledBack { got: self.number, known: held.number })
            }
            Some(Self { signer: Some(signer), .. }) if self.signer != Some(*signer) => {
                Err(CertError::Retired { what: Self::KIND, signer: signer.to_string() })
            }
            _ => Ok(()),
        }
    }
}

impl Claims for Revocation {
    const KIND: &'static str = "Revocation";
    const LABEL: &'static str = "GDP REVOCATION";
    const CONTEXT: &'static str = "application/vnd.gdp.revocation.v2+cbor";

    fn validity(&self) -> Validity {
        Validity::ALWAYS
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        let count = self.revoked.len();
        if count > MAX_REVOKED {
            return Err(CertError::Malformed(format!(
                "{count} revoked serials where at most {MAX_REVOKED} are allowed; raise the floor"
            )));
        }
        if !self.revoked.is_sorted_by(|a, b| a < b) {
            return Err(CertError::Malformed("the revoked serials are not in rising order".into()));
        }
        Ok(())
    }
}

impl Signed<Revocation> {
    /// Verifies that the owner of `name`, or the successor of a domain's key, revoked it.
    pub fn verify_revocation(&self, name: &NameProof) -> Result<Revocation, CertError> {
        let claims = self.verify_for_name(name)?;
        let expected = name.name()?;
        if claims.name != expected {
            return Err(CertError::WrongName { expected, got: claims.name });
        }
        claims.check_signer(self)?;
        // The first key cannot retire its successor.
        if claims.signer.is_some_and(|signer| *signer.as_bytes() == name.owner_key) {
            return Err(CertError::Malformed(
                "the owner's key retires no other; only a successor retires a key".into(),
            ));
        }
        Ok(claims)
    }
}

pub(super) fn check_role(role: &str) -> Result<(), CertError> {
    let good = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_' || c == b'-';
    if (1..=MAX_ROLE).contains(&role.len()) && role.bytes().all(good) {
        return Ok(());
    }
    Err(CertError::Malformed(format!("a role has 1 to {MAX_ROLE} characters of a-z, 0-9, _ and -")))
}
