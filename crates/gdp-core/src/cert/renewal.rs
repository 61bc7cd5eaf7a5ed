//! Renewal of memberships. For each member, the domain states who may renew its membership, for
//! how long, and until when. The holder of that key can extend a membership and admit nobody, so
//! the domain's own key may be offline.

use super::pem::Blocks;
use super::{BACKDATED, Claims, MemberCert, Signed, Validity};
use crate::cert::error::CertError;
use crate::cert::name_proof::expect_domain;
use crate::name::{Name, NameProof};
use crate::verify_key::VerifyKey;
use serde::{Deserialize, Serialize};

/// Certificate of a domain: the holder of `key` may renew the membership of one member. The
/// validity bounds the renewed memberships.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RenewalDelegation {
    pub domain: Name,
    /// Serial of the member's [`Invite`](super::Invite) or [`MemberCert`].
    pub member: u64,
    pub key: VerifyKey,
    /// Maximum time in seconds for which a renewed membership holds, besides [`BACKDATED`].
    pub lifetime: u64,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
}

impl Claims for RenewalDelegation {
    const KIND: &'static str = "RenewalDelegation";
    const LABEL: &'static str = "GDP RENEWAL DELEGATION";
    const CONTEXT: &'static str = "application/vnd.gdp.renewal-delegation.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        if self.lifetime == 0 {
            return Err(CertError::Malformed("a renewed membership would end at once".into()));
        }
        self.validity().check_order()
    }
}

/// The last renewal of a membership, with its evidence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MembershipRenewal {
    pub delegation: Signed<RenewalDelegation>,
    /// The membership again, signed by the key of the delegation.
    pub cert: Signed<MemberCert>,
}

impl MembershipRenewal {
    /// Verifies the signatures, regardless of time and revocations. `base` are the verified claims
    /// of the membership without its renewal, `member` its serial. Returns `base` with the
    /// validity of the renewal.
    pub(super) fn verify_signatures(
        &self,
        domain: &NameProof,
        base: MemberCert,
        member: u64,
    ) -> Result<MemberCert, CertError> {
        let delegation = self.delegation.verify_for_name(domain)?;
        expect_domain(base.domain, delegation.domain)?;
        let renewed = self.cert.verify_signature(&delegation.key)?;
        if delegation.member != member || (renewed.domain, renewed.entity) != (base.domain, base.entity) {
            return Err(CertError::Malformed("the renewal is of another membership".into()));
        }
        if renewed.role != base.role {
            return Err(CertError::WrongRole { expected: base.role, got: renewed.role });
        }
        if renewed.serial < delegation.serial {
            let (what, serial) = (MemberCert::KIND, renewed.serial);
            return Err(CertError::BeforeDelegation { what, serial, delegation: delegation.serial });
        }
        if renewed.not_after.saturating_sub(renewed.not_before) > delegation.lifetime.saturating_add(BACKDATED) {
            return Err(CertError::Malformed("the renewal lasts longer than its delegation allows".into()));
        }
        let Validity { not_before, not_after } = renewed.validity().and(delegation.validity());
        Ok(MemberCert { not_before, not_after, ..base })
    }

    /// Returns the kinds and serials of its certificates, unverified.
    pub(super) fn serials_unverified(&self) -> Result<[(&'static str, u64); 2], CertError> {
        let delegation = self.delegation.claims_unverified()?.serial;
        Ok([(RenewalDelegation::KIND, delegation), (MemberCert::KIND, self.cert.claims_unverified()?.serial)])
    }

    pub(super) fn size(&self) -> usize {
        self.delegation.as_bytes().len() + self.cert.as_bytes().len()
    }

    pub(super) fn to_pem(&self) -> String {
        self.delegation.to_pem() + &self.cert.to_pem()
    }

    /// Parses the blocks of a renewal, if the next one is of its delegation.
    pub(super) fn from_blocks(blocks: &mut Blocks) -> Result<Option<Self>, CertError> {
        let Some(delegation) = blocks.take_if(RenewalDelegation::LABEL) else { return Ok(None) };
        let cert = Signed::from_pem(blocks.take(MemberCert::LABEL)?)?;
        Ok(Some(Self { delegation: Signed::from_pem(delegation)?, cert }))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cert/renewal.rs"]
mod tests;
