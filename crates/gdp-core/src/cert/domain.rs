//! Certificates that a trust domain issues: to its members, to inviters of members, and to other
//! domains. A domain is an entity of kind "domain" whose key is kept off the switches. The domain
//! revokes them by a [`Revocation`] of its own name.
//!
//! Serials are those of owners' certificates: the Unix time of issue in nanoseconds.

use super::owner::check_role;
use super::{Claims, Revocation, Signed, Validity};
use crate::cert::error::CertError;
use crate::cert::name_proof::expect_domain;
use crate::name::{Name, NameProof};
use crate::verify_key::VerifyKey;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Roles that the fabric itself knows. Grants may name any other role.
pub mod roles {
    /// Switch that may have links with the domain's switches.
    pub const SWITCH: &str = "switch";
    /// Switch with the domain's RIB.
    pub const RIB: &str = "rib";
    /// Switch that has links with switches of other domains.
    pub const BORDER: &str = "border";
    /// Machine that asks to become a member. Its invitation admits any number of machines.
    pub const APPLICANT: &str = "applicant";

    /// Returns whether a holder of this role may be a switch of the domain.
    pub fn is_switch(role: &str) -> bool {
        [SWITCH, RIB, BORDER].contains(&role)
    }
}

/// Certificate of a domain that an entity has this role among its members.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemberCert {
    pub domain: Name,
    pub entity: Name,
    pub role: String,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
}

impl Claims for MemberCert {
    const KIND: &'static str = "MemberCert";
    const LABEL: &'static str = "GDP MEMBER CERT";
    const CONTEXT: &'static str = "application/vnd.gdp.member-cert.v2+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        check_role(&self.role)?;
        self.validity().check_order()
    }
}

/// Invitation by a domain: the holder of `key` may admit one entity in this role.
///
/// The first such entity that the domain's RIB sees is admitted; of [applicants](roles::APPLICANT)
/// each is. The validity bounds the use of the invitation; the admitted membership may last longer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Invite {
    pub domain: Name,
    pub key: VerifyKey,
    pub role: String,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
    /// Latest end of the admitted membership in Unix seconds.
    pub member_until: u64,
}

impl Claims for Invite {
    const KIND: &'static str = "Invite";
    const LABEL: &'static str = "GDP INVITE";
    const CONTEXT: &'static str = "application/vnd.gdp.invite.v2+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        check_role(&self.role)?;
        self.validity().check_order()?;
        if self.member_until < self.not_after {
            return Err(CertError::Malformed("an invitation holds for longer than whom it admits".into()));
        }
        Ok(())
    }
}

/// Rights that a domain grants another. The certificate itself states that the other domain is
/// known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeerRights {
    /// Border switches of the other domain may have links with this domain's.
    pub peering: bool,
    /// Traffic of the other domain may cross this domain into a third.
    pub transit: bool,
    /// Robots of the other domain may attach to this domain's switches.
    pub visit: bool,
}

impl fmt::Display for PeerRights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let held = [(self.peering, "peering"), (self.transit, "transit"), (self.visit, "visit")];
        let held: Vec<_> = held.into_iter().filter(|(held, _)| *held).map(|(_, name)| name).collect();
        f.write_str(&if held.is_empty() { "none".to_owned() } else { held.join(",") })
    }
}

impl FromStr for PeerRights {
    type Err = String;

    /// Parses one or more of `peering`, `transit` and `visit`, separated by commas.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut rights = Self::default();
        for right in text.split(',') {
            match right.trim() {
                "peering" => rights.peering = true,
                "transit" => rights.transit = true,
                "visit" => rights.visit = true,
                other => return Err(format!("{other:?} is no right; expected some of peering,transit,visit")),
            }
        }
        Ok(rights)
    }
}

/// Certificate of a domain that grants these rights to another domain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PeerCert {
    pub domain: Name,
    pub peer: Name,
    pub rights: PeerRights,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
}

impl Claims for PeerCert {
    const KIND: &'static str = "PeerCert";
    const LABEL: &'static str = "GDP PEER CERT";
    const CONTEXT: &'static str = "application/vnd.gdp.peer-cert.v2+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        if self.peer == self.domain {
            return Err(CertError::Malformed("a domain is no peer of its own".into()));
        }
        self.validity().check_order()
    }
}

impl Signed<PeerCert> {
    /// Verifies the signature, domain, revocation and validity of the certificate and returns its
    /// claims.
    pub fn verify_peer(
        &self,
        proof: &NameProof,
        revocation: Option<&Revocation>,
        now: u64,
    ) -> Result<PeerCert, CertError> {
        let claims = self.verify_for_name(proof)?;
        expect_domain(proof.name()?, claims.domain)?;
        check_not_revoked(PeerCert::KIND, claims.serial, revocation)?;
        revocation.map_or(Ok(()), |revocation| revocation.check_signer(self))?;
        claims.check_time(now)?;
        Ok(claims)
    }
}

pub(super) fn check_not_revoked(
    what: &'static str,
    serial: u64,
    revocation: Option<&Revocation>,
) -> Result<(), CertError> {
    revocation.map_or(Ok(()), |revocation| revocation.check(what, serial))
}
