//! Membership of an entity in a domain, with its evidence: verification, renewal and text form.

use super::block::decode_block;
use super::domain::check_not_revoked;
use super::pem::Blocks;
use super::{BACKDATED, Claims, Invite, MemberCert, MembershipRenewal, RenewalDelegation, Revocation, Signed, issue};
use crate::cbor;
use crate::cert::error::CertError;
use crate::cert::name_proof::{MAX_PROOF, PROOF_LABEL, expect_domain};
use crate::identity::{Identity, SigningKey};
use crate::name::{Name, NameProof};
use crate::verify_key::VerifyKey;
use gdp_util::date::rfc3339;
use p256::pkcs8::{LineEnding, der::pem};
use serde::{Deserialize, Serialize};

/// Role of an entity in a domain, with its evidence. The evidence is the proof of the domain's
/// name, which holds its key, and the invitation, if the entity was admitted by one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Membership {
    pub domain: NameProof,
    pub cert: Signed<MemberCert>,
    pub invite: Option<Signed<Invite>>,
    /// The last renewal, which extends the validity of `cert`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renewal: Option<MembershipRenewal>,
}

impl Membership {
    /// Issues a membership signed by `domain`, an identity of kind "domain".
    pub fn issue(domain: &Identity, claims: &MemberCert) -> Result<Self, CertError> {
        expect_domain(domain.name(), claims.domain)?;
        Ok(Self { domain: domain.proof(), cert: issue(domain.key(), claims)?, invite: None, renewal: None })
    }

    /// Verifies the membership in `domain` at `now` and returns its claims.
    ///
    /// `revocation` is the newest known one of the domain. Only the domain's RIB knows whether an
    /// invitation has already admitted another entity.
    pub fn verify(&self, domain: Name, revocation: Option<&Revocation>, now: u64) -> Result<MemberCert, CertError> {
        let claims = self.verify_signatures(domain)?;
        self.check_revoked(revocation)?;
        claims.check_time(now)?;
        Ok(claims)
    }

    /// Verifies the signatures as [`Self::verify`] does, regardless of time and revocations.
    pub fn verify_signatures(&self, domain: Name) -> Result<MemberCert, CertError> {
        expect_domain(domain, self.domain.name()?)?;
        if let Some(kind) = self.domain.kind_but_domain() {
            return Err(CertError::NotADomain { name: domain, kind });
        }
        let base = match &self.invite {
            Some(invite) => self.verify_invited(invite, domain)?,
            None => self.cert.verify_for_name(&self.domain)?,
        };
        expect_domain(domain, base.domain)?;
        match &self.renewal {
            Some(renewal) => renewal.verify_signatures(&self.domain, base, self.serial_unverified()?),
            None => Ok(base),
        }
    }

    /// Verifies the signatures of an invitation, and of the certificate that its key signed.
    fn verify_invited(&self, invite: &Signed<Invite>, domain: Name) -> Result<MemberCert, CertError> {
        let invite = invite.verify_for_name(&self.domain)?;
        expect_domain(domain, invite.domain)?;
        let claims = self.cert.verify_signature(&invite.key)?;
        if claims.role != invite.role {
            return Err(CertError::WrongRole { expected: invite.role, got: claims.role });
        }
        if claims.not_after > invite.member_until {
            return Err(CertError::Malformed(format!(
                "it ends {}, and the invitation admits members until {}",
                rfc3339(claims.not_after),
                rfc3339(invite.member_until)
            )));
        }
        // This check catches honest latecomers. The RIB catches backdated certificates.
        let issued = claims.serial / 1_000_000_000;
        if issued > invite.not_after {
            return Err(CertError::Expired { at: invite.not_after, now: issued });
        }
        // Otherwise a certificate issued under a revoked invitation would be valid under the next
        // one.
        if claims.serial < invite.serial {
            return Err(CertError::BeforeDelegation {
                what: MemberCert::KIND,
                serial: claims.serial,
                delegation: invite.serial,
            });
        }
        Ok(claims)
    }

    /// Returns the invitation of the membership, unverified.
    pub fn invite_unverified(&self) -> Result<Option<Invite>, CertError> {
        self.invite.as_ref().map(Signed::claims_unverified).transpose()
    }

    /// Returns the domain's key that signed the membership or its invitation, unverified.
    pub fn signer_unverified(&self) -> Result<VerifyKey, CertError> {
        match &self.invite {
            Some(invite) => invite.signer_unverified(),
            None => self.cert.signer_unverified(),
        }
    }

    /// Returns the serial by which the membership is revoked. With an invitation, that is the
    /// invitation's serial, because the holder of its key chooses the serials of what it issues.
    pub fn serial_unverified(&self) -> Result<u64, CertError> {
        match self.invite_unverified()? {
            Some(invite) => Ok(invite.serial),
            None => Ok(self.cert.claims_unverified()?.serial),
        }
    }

    /// Checks that neither certificate nor invitation is revoked. `revocation` is the newest known
    /// one of the domain.
    pub fn check_revoked(&self, revocation: Option<&Revocation>) -> Result<(), CertError> {
        if let Some(revocation) = revocation {
            let signed = self.invite.as_ref().map(|invite| revocation.check_signer(invite));
            signed.unwrap_or_else(|| revocation.check_signer(&self.cert))?;
            self.renewal.iter().try_for_each(|renewal| revocation.check_signer(&renewal.delegation))?;
        }
        if let Some(invite) = self.invite_unverified()? {
            check_not_revoked(Invite::KIND, invite.serial, revocation)?;
        }
        for (what, serial) in self.renewal.iter().flat_map(MembershipRenewal::serials_unverified).flatten() {
            check_not_revoked(what, serial, revocation)?;
        }
        check_not_revoked(MemberCert::KIND, self.cert.claims_unverified()?.serial, revocation)
    }

    /// Returns the bytes of the signed parts and the maximum size of a proof.
    pub fn size(&self) -> usize {
        let invite = self.invite.as_ref().map_or(0, |invite| invite.as_bytes().len());
        self.cert.as_bytes().len() + invite + self.renewal.as_ref().map_or(0, MembershipRenewal::size) + MAX_PROOF
    }

    /// Returns the text form for files: the blocks of MemberCert, Invite, renewal and the domain's
    /// name proof, in this order.
    pub fn to_pem(&self) -> String {
        let proof = cbor::encode(&self.domain).expect("a map of two byte strings has an encoding");
        let proof = pem::encode_string(PROOF_LABEL, LineEnding::LF, &proof);
        self.cert.to_pem()
            + &self.invite.as_ref().map(Signed::to_pem).unwrap_or_default()
            + &self.renewal.as_ref().map(MembershipRenewal::to_pem).unwrap_or_default()
            + &proof.expect("the label and the size are fixed, so there is a text form")
    }

    pub fn from_pem(text: &str) -> Result<Self, CertError> {
        let mut blocks = Blocks::of(text)?;
        let member = Self::from_blocks(&mut blocks)?;
        blocks.end()?;
        Ok(member)
    }

    pub(super) fn from_blocks(blocks: &mut Blocks) -> Result<Self, CertError> {
        let cert = Signed::from_pem(blocks.take(MemberCert::LABEL)?)?;
        let invite = blocks.take_if(Invite::LABEL).map(Signed::from_pem).transpose()?;
        let renewal = MembershipRenewal::from_blocks(blocks)?;
        let proof = decode_block(PROOF_LABEL, blocks.take(PROOF_LABEL)?)?;
        Ok(Self { cert, invite, renewal, domain: cbor::decode(&proof, MAX_PROOF)? })
    }

    /// Renews this membership by the key of `delegation` at `now` (Unix nanoseconds). The caller
    /// checks revocations.
    pub fn renew(&self, key: &SigningKey, delegation: &Signed<RenewalDelegation>, now: u64) -> Result<Self, CertError> {
        let terms = delegation.claims_unverified()?;
        let seconds = now / 1_000_000_000;
        let base = Self { renewal: None, ..self.clone() };
        let claims = MemberCert {
            serial: now.max(terms.serial),
            not_before: seconds.saturating_sub(BACKDATED),
            not_after: seconds.saturating_add(terms.lifetime).min(terms.not_after),
            ..base.verify_signatures(terms.domain)?
        };
        let renewal = MembershipRenewal { delegation: delegation.clone(), cert: issue(key, &claims)? };
        let renewed = Self { renewal: Some(renewal), ..base };
        renewed.verify(terms.domain, None, seconds)?;
        Ok(renewed)
    }

    /// Returns when the membership with its renewal ends in Unix seconds, unverified.
    pub fn until_unverified(&self) -> Result<u64, CertError> {
        Ok(self.last_unverified()?.not_after)
    }

    /// Whether half of the membership has passed since it was issued or renewed, or the clock was
    /// set back. `now` is in Unix seconds.
    pub fn is_half_over(&self, now: u64) -> Result<bool, CertError> {
        let last = self.last_unverified()?;
        let issued = last.serial / 1_000_000_000;
        Ok(!(issued..issued + last.not_after.saturating_sub(issued) / 2).contains(&now))
    }

    fn last_unverified(&self) -> Result<MemberCert, CertError> {
        self.renewal.as_ref().map_or(&self.cert, |renewal| &renewal.cert).claims_unverified()
    }
}
