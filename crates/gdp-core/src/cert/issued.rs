//! Certificates with their evidence, as sent in messages and stored in files. The evidence is the
//! delegation to the issuer, and for a grant to a role, the reader's membership.

use super::pem::{Blocks, MAX_TEXT};
use super::{AboutName, AdCert, Claims, Delegation, Grantee, Membership, ReadGrant, Revocation, Signed};
use crate::cert::error::CertError;
use crate::name::{Name, NameProof};
use serde::{Deserialize, Serialize};

/// Certificate of a name's owner, or of a delegate with its delegation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(bound = "", deny_unknown_fields)]
pub struct Issued<T: Claims> {
    pub cert: Signed<T>,
    /// Delegation to the issuer. `None` if the owner signed the certificate.
    pub delegation: Option<Signed<Delegation>>,
}

impl<T: Claims> From<Signed<T>> for Issued<T> {
    fn from(cert: Signed<T>) -> Self {
        Self { cert, delegation: None }
    }
}

impl<T: AboutName> Issued<T> {
    /// Verifies the chain to the owner in `proof` at `now` (Unix seconds) and returns the claims.
    ///
    /// `revocation` is the newest known one of the name. The validity of the returned claims is
    /// that of the whole chain.
    pub fn verify(&self, proof: &NameProof, revocation: Option<&Revocation>, now: u64) -> Result<T, CertError> {
        let name = proof.name()?;
        if let Some(revocation) = revocation {
            expect_name(name, revocation.name)?;
        }
        let holds = |what, serial| revocation.map_or(Ok(()), |revocation| revocation.check(what, serial));
        let Some(delegation) = &self.delegation else {
            let claims = self.cert.verify(&proof.verify_key()?, now)?;
            expect_name(name, claims.name())?;
            holds(T::KIND, claims.serial())?;
            return Ok(claims);
        };
        let delegation = delegation.verify(&proof.verify_key()?, now)?;
        expect_name(name, delegation.name)?;
        holds(Delegation::KIND, delegation.serial)?;
        if !T::is_delegated(&delegation) {
            return Err(CertError::NotDelegated { what: T::KIND, delegate: delegation.delegate.to_string() });
        }
        let mut claims = self.cert.verify(&delegation.delegate, now)?;
        expect_name(name, claims.name())?;
        holds(T::KIND, claims.serial())?;
        // Otherwise a new delegation to the same key would restore certificates that fell with an
        // earlier one.
        if claims.serial() < delegation.serial {
            return Err(CertError::BeforeDelegation {
                what: T::KIND,
                serial: claims.serial(),
                delegation: delegation.serial,
            });
        }
        claims.set_validity(claims.validity().and(delegation.validity()));
        Ok(claims)
    }
}

impl<T: AboutName> Issued<T> {
    /// Returns the kind and serial of each revocable part, unverified.
    pub fn serials(&self) -> Result<Vec<(&'static str, u64)>, CertError> {
        let mut serials = vec![(T::KIND, self.cert.claims_unverified()?.serial())];
        if let Some(delegation) = &self.delegation {
            serials.push((Delegation::KIND, delegation.claims_unverified()?.serial));
        }
        Ok(serials)
    }
}

impl<T: Claims> Issued<T> {
    /// Returns the bytes of the signed parts.
    pub fn size(&self) -> usize {
        self.cert.as_bytes().len() + self.delegation.as_ref().map_or(0, |delegation| delegation.as_bytes().len())
    }

    /// Returns the text form for files: one block after another.
    pub fn to_pem(&self) -> String {
        self.cert.to_pem() + &self.delegation.as_ref().map(Signed::to_pem).unwrap_or_default()
    }

    pub fn from_pem(text: &str) -> Result<Self, CertError> {
        let mut blocks = Blocks::of(text)?;
        let issued = Self::from_blocks(&mut blocks)?;
        blocks.end()?;
        Ok(issued)
    }

    fn from_blocks(blocks: &mut Blocks) -> Result<Self, CertError> {
        let cert = Signed::from_pem(blocks.take(T::LABEL)?)?;
        let delegation = blocks.take_if(Delegation::LABEL).map(Signed::from_pem).transpose()?;
        Ok(Self { cert, delegation })
    }
}

impl Issued<AdCert> {
    /// Verifies the certificate as [`Issued::verify`] does, and that it is for `entity`.
    pub fn verify_for(
        &self,
        proof: &NameProof,
        entity: Name,
        revocation: Option<&Revocation>,
        now: u64,
    ) -> Result<AdCert, CertError> {
        let cert = self.verify(proof, revocation, now)?;
        expect_entity(entity, cert.entity)?;
        Ok(cert)
    }
}

/// Evidence of a reader: its grant, and its membership if the grant is for a role.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reading {
    pub grant: Issued<ReadGrant>,
    pub member: Option<Box<Membership>>,
}

impl<T: Into<Issued<ReadGrant>>> From<T> for Reading {
    fn from(grant: T) -> Self {
        Self { grant: grant.into(), member: None }
    }
}

impl Reading {
    /// Verifies the grant as [`Issued::verify`] does, and that it covers `entity`.
    ///
    /// The validity of the returned claims is that of all the evidence. [`Self::check_member`]
    /// checks whether the domain has revoked the membership.
    pub fn verify(
        &self,
        proof: &NameProof,
        entity: Name,
        revocation: Option<&Revocation>,
        now: u64,
    ) -> Result<ReadGrant, CertError> {
        let mut grant = self.grant.verify(proof, revocation, now)?;
        match (&grant.to, &self.member) {
            (Grantee::Entity(granted), None) => expect_entity(entity, *granted)?,
            (Grantee::Entity(_), Some(_)) => {
                return Err(CertError::Malformed("a membership is shown with a grant that asks for none".into()));
            }
            (Grantee::Role { domain, role }, None) => {
                return Err(CertError::NotAMember { role: role.clone(), domain: *domain });
            }
            (Grantee::Role { domain, role }, Some(member)) => {
                // Only the RIB knows that an invitation admits one reader only, and writers need
                // not trust a RIB.
                if member.invite.is_some() {
                    return Err(CertError::ByInvitation { role: role.clone(), domain: *domain });
                }
                let member = member.verify(*domain, None, now)?;
                expect_entity(entity, member.entity)?;
                if member.role != *role {
                    return Err(CertError::WrongRole { expected: role.clone(), got: member.role });
                }
                grant.set_validity(grant.validity().and(member.validity()));
            }
        }
        Ok(grant)
    }

    /// Checks that the domain has not revoked the membership, if there is one. `newest` returns the
    /// newest known revocation of a domain.
    pub fn check_member<'a>(&self, newest: impl FnOnce(&Name) -> Option<&'a Revocation>) -> Result<(), CertError> {
        let Some(member) = &self.member else { return Ok(()) };
        member.check_revoked(newest(&member.domain.name()?))
    }

    /// Returns the bytes of the signed parts.
    pub fn size(&self) -> usize {
        self.grant.size() + self.member.as_ref().map_or(0, |member| member.size())
    }

    /// Returns the text form for files: one block after another.
    pub fn to_pem(&self) -> String {
        self.grant.to_pem() + &self.member.as_ref().map(|member| member.to_pem()).unwrap_or_default()
    }

    /// Parses the blocks of the grant, then those of the membership, if there are any.
    pub fn from_pem(text: &str) -> Result<Self, CertError> {
        let mut blocks = Blocks::of(text)?;
        let grant = Issued::from_blocks(&mut blocks)?;
        let member = if blocks.is_empty() { None } else { Some(Membership::from_blocks(&mut blocks)?) };
        blocks.end()?;
        Ok(Self { grant, member: member.map(Box::new) })
    }
}

/// Maximum bytes of a certificate file.
pub const MAX_CERT_FILE: usize = MAX_TEXT;

pub(super) fn expect_name(expected: Name, got: Name) -> Result<(), CertError> {
    if expected == got { Ok(()) } else { Err(CertError::WrongName { expected, got }) }
}

pub(super) fn expect_entity(expected: Name, got: Name) -> Result<(), CertError> {
    if expected == got { Ok(()) } else { Err(CertError::WrongEntity { expected, got }) }
}
