//! What a trust domain issues: to its members, to who may admit one more, and to other domains. A
//! domain is an entity of kind "domain" whose key is kept off the switches. What it takes back is a
//! [`Revocation`] of the domain's own name.
//!
//! Serials are those of owners' certificates: the Unix time in nanoseconds of the issue.

use super::owner::check_role;
use super::pem::Blocks;
use super::{Claims, Revocation, Signed, Validity, issue};
use crate::cbor;
use crate::cert::error::CertError;
use crate::cert::name_proof::{MAX_PROOF, PROOF_LABEL, expect_domain};
use crate::identity::Identity;
use crate::name::{Name, NameProof};
use crate::verify_key::VerifyKey;
use p256::pkcs8::{LineEnding, der::pem};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Roles that the fabric itself knows. Any other is for grants to name.
pub mod roles {
    /// May have links with the domain's switches, as one.
    pub const SWITCH: &str = "switch";
    /// A switch with the domain's RIB.
    pub const RIB: &str = "rib";
    /// A switch that has links with those of other domains.
    pub const BORDER: &str = "border";

    /// Whether who has this role may be a switch of the domain.
    pub fn is_switch(role: &str) -> bool {
        [SWITCH, RIB, BORDER].contains(&role)
    }
}

/// Domain → entity: has this role among my members.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
    const CONTEXT: &'static str = "application/vnd.gdp.member-cert.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        check_role(&self.role)?;
        self.validity().check_order()
    }
}

/// Domain → whoever holds `key`: may admit one entity in this role, the first that the domain's RIB
/// sees. It is to be used while the invitation holds; who was admitted may be a member for longer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Invite {
    pub domain: Name,
    pub key: VerifyKey,
    pub role: String,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
    /// Until when who was admitted may be a member.
    pub member_until: u64,
}

impl Claims for Invite {
    const KIND: &'static str = "Invite";
    const LABEL: &'static str = "GDP INVITE";
    const CONTEXT: &'static str = "application/vnd.gdp.invite.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
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

/// What a domain lets another do. That there is a certificate at all says that the other is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeerRights {
    /// Its border switches may have links with mine.
    pub peering: bool,
    /// What it sends may cross me into a third domain.
    pub transit: bool,
    /// Its robots may attach to my switches.
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

    /// `peering,transit,visit`: one or more of them.
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

/// Domain → another domain: may do this with me.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
    const CONTEXT: &'static str = "application/vnd.gdp.peer-cert.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        if self.peer == self.domain {
            return Err(CertError::Malformed("a domain is no peer of its own".into()));
        }
        self.validity().check_order()
    }
}

impl Signed<PeerCert> {
    /// What the domain that `proof` shows states, if it stands behind it now.
    pub fn verify_peer(
        &self,
        proof: &NameProof,
        revocation: Option<&Revocation>,
        now: u64,
    ) -> Result<PeerCert, CertError> {
        let claims = self.verify_signature(&proof.verify_key()?)?;
        expect_domain(proof.name()?, claims.domain)?;
        check_not_revoked(PeerCert::KIND, claims.serial, revocation)?;
        claims.validity().check(now)?;
        Ok(claims)
    }
}

/// An entity's role in a domain, and what that rests on: how the domain's name shows the key that
/// says so, and the invitation by which the entity was admitted, if it was.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Membership {
    pub domain: NameProof,
    pub cert: Signed<MemberCert>,
    pub invite: Option<Signed<Invite>>,
}

impl Membership {
    /// Signed by `domain`, an identity of kind "domain", about one of its members.
    pub fn issue(domain: &Identity, claims: &MemberCert) -> Result<Self, CertError> {
        expect_domain(domain.name(), claims.domain)?;
        Ok(Self { domain: domain.proof(), cert: issue(domain.key(), claims)?, invite: None })
    }

    /// What it states, if this domain stands behind it at `now`. `revocation` is the newest that is
    /// known of the domain. Whether an invitation has admitted somebody else already is for the
    /// domain's RIB to know.
    pub fn verify(&self, domain: Name, revocation: Option<&Revocation>, now: u64) -> Result<MemberCert, CertError> {
        let claims = self.verify_signatures(domain)?;
        self.check_revoked(revocation)?;
        claims.validity().check(now)?;
        Ok(claims)
    }

    /// As [`Self::verify`], at any time and whatever was revoked.
    pub fn verify_signatures(&self, domain: Name) -> Result<MemberCert, CertError> {
        expect_domain(domain, self.domain.name()?)?;
        let domain_key = self.domain.verify_key()?;
        let Some(invite) = &self.invite else {
            let claims = self.cert.verify_signature(&domain_key)?;
            expect_domain(domain, claims.domain)?;
            return Ok(claims);
        };
        let invite = invite.verify_signature(&domain_key)?;
        expect_domain(domain, invite.domain)?;
        let claims = self.cert.verify_signature(&invite.key)?;
        expect_domain(domain, claims.domain)?;
        if claims.role != invite.role {
            return Err(CertError::WrongRole { expected: invite.role, got: claims.role });
        }
        if claims.not_after > invite.member_until {
            return Err(CertError::Malformed(format!(
                "it ends at Unix time {}, and the invitation admits members until {}",
                claims.not_after, invite.member_until
            )));
        }
        // Honest late-comers are told here; those who backdate, by the RIB.
        let issued = claims.serial / 1_000_000_000;
        if issued > invite.not_after {
            return Err(CertError::Expired { at: invite.not_after, now: issued });
        }
        // Otherwise what was issued under an invitation that was taken back would hold by the next
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

    /// The invitation that it rests on, believed by nobody.
    pub fn invite_unverified(&self) -> Result<Option<Invite>, CertError> {
        self.invite.as_ref().map(Signed::claims_unverified).transpose()
    }

    /// The serial that takes it back: whoever holds an invitation's key chooses the serials of what
    /// it issues.
    pub fn serial_unverified(&self) -> Result<u64, CertError> {
        match self.invite_unverified()? {
            Some(invite) => Ok(invite.serial),
            None => Ok(self.cert.claims_unverified()?.serial),
        }
    }

    /// Whether nothing of it was taken back. `revocation` is the newest that is known of the
    /// domain.
    pub fn check_revoked(&self, revocation: Option<&Revocation>) -> Result<(), CertError> {
        if let Some(invite) = self.invite_unverified()? {
            check_not_revoked(Invite::KIND, invite.serial, revocation)?;
        }
        check_not_revoked(MemberCert::KIND, self.cert.claims_unverified()?.serial, revocation)
    }

    /// Bytes of what is signed in it.
    pub fn size(&self) -> usize {
        self.cert.as_bytes().len() + self.invite.as_ref().map_or(0, |invite| invite.as_bytes().len()) + MAX_PROOF
    }

    /// The text form for files: MemberCert, Invite, name proof of the domain, one block after
    /// another.
    pub fn to_pem(&self) -> String {
        let proof = cbor::encode(&self.domain).expect("a map of two byte strings has an encoding");
        let proof = pem::encode_string(PROOF_LABEL, LineEnding::LF, &proof);
        self.cert.to_pem()
            + &self.invite.as_ref().map(Signed::to_pem).unwrap_or_default()
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
        let (_, proof) = pem::decode_vec(blocks.take(PROOF_LABEL)?.as_bytes())
            .map_err(|error| CertError::Malformed(format!("{PROOF_LABEL}: {error}")))?;
        Ok(Self { cert, invite, domain: cbor::decode(&proof, MAX_PROOF)? })
    }
}

fn check_not_revoked(what: &'static str, serial: u64, revocation: Option<&Revocation>) -> Result<(), CertError> {
    revocation.map_or(Ok(()), |revocation| revocation.check(what, serial))
}
