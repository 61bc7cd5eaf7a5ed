//! Certificates that a trust domain issues: to its members, to inviters of members, and to other
//! domains. A domain is an entity of kind "domain" whose key is kept off the switches. The domain
//! revokes them by a [`Revocation`] of its own name.
//!
//! Serials are those of owners' certificates: the Unix time of issue in nanoseconds.

use super::owner::check_role;
use super::pem::Blocks;
use super::renewal::MembershipRenewal;
use super::{Claims, Revocation, Signed, Validity, issue};
use crate::cbor;
use crate::cert::error::CertError;
use crate::cert::name_proof::{MAX_PROOF, PROOF_LABEL, expect_domain};
use crate::identity::Identity;
use crate::name::{Name, NameProof};
use crate::verify_key::VerifyKey;
use gdp_util::date::rfc3339;
use p256::pkcs8::{LineEnding, der::pem};
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
        let (_, proof) = pem::decode_vec(blocks.take(PROOF_LABEL)?.as_bytes())
            .map_err(|error| CertError::Malformed(format!("{PROOF_LABEL}: {error}")))?;
        Ok(Self { cert, invite, renewal, domain: cbor::decode(&proof, MAX_PROOF)? })
    }
}

fn check_not_revoked(what: &'static str, serial: u64, revocation: Option<&Revocation>) -> Result<(), CertError> {
    revocation.map_or(Ok(()), |revocation| revocation.check(what, serial))
}
