//! Statement with the certificates that authorise it, as a RIB stores it.

use crate::control::role::NameRole;
use gdp_core::cert::{
    AdCert, Advert, CertError, Issued, Membership, Reading, Revocation, Side, Signed, verify_statement,
};
use gdp_core::name::NameProof;
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

/// Verified advertisement or subscription, with everything needed to verify it again.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    pub name: Name,
    /// Proof of `name`, which holds the owner's key.
    pub proof: NameProof,
    /// Proof of the entity's name, which holds its key.
    pub entity: NameProof,
    /// Switch of the entity's attachment.
    pub switch: Name,
    pub credential: Credential,
    /// Statement of the entity itself.
    pub advert: Signed<Advert>,
    /// Seconds until the record expires, on the clock of the answering RIB.
    pub expires_in: u64,
}

/// Credential of a name's owner for an entity. Its kind tells writers from readers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Credential {
    Writer(Issued<AdCert>),
    Reader(Reading),
}

impl Credential {
    /// Returns the bytes of the signed parts.
    pub fn size(&self) -> usize {
        match self {
            Self::Writer(cert) => cert.size(),
            Self::Reader(grant) => grant.size(),
        }
    }

    /// Returns the domains, besides its own, that may know a writer; empty for a reader. The result
    /// is unverified.
    pub fn scope(&self) -> Result<Vec<Name>, CertError> {
        match self {
            Self::Writer(cert) => Ok(cert.cert.claims_unverified()?.scope),
            Self::Reader(_) => Ok(Vec::new()),
        }
    }

    /// Returns the membership of a reader's credential, if it needs one.
    pub fn member(&self) -> Option<&Membership> {
        match self {
            Self::Writer(_) => None,
            Self::Reader(grant) => grant.member.as_deref(),
        }
    }

    /// Checks the membership as [`Reading::check_member`] does; a writer needs none.
    pub fn check_member<'a>(&self, newest: impl FnOnce(&Name) -> Option<&'a Revocation>) -> Result<(), CertError> {
        match self {
            Self::Writer(_) => Ok(()),
            Self::Reader(grant) => grant.check_member(newest),
        }
    }

    /// Returns the kind and serial of each revocable part, unverified.
    pub fn serials(&self) -> Result<Vec<(&'static str, u64)>, CertError> {
        match self {
            Self::Writer(cert) => cert.serials(),
            Self::Reader(reading) => reading.grant.serials(),
        }
    }
}

/// Result of verifying a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verified {
    pub entity: Name,
    pub advert: Advert,
    /// End of the credential's chain in Unix seconds.
    pub not_after: u64,
}

/// Key of a record, in the order in which a RIB lists records: by name, then role with writers
/// before readers, then entity and switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RecordKey {
    pub name: Name,
    pub role: NameRole,
    pub entity: Name,
    pub switch: Name,
}

impl Record {
    /// Returns the record's key. Fails if the entity's key is invalid or the statement is a
    /// withdrawal.
    pub fn key(&self) -> Result<RecordKey, CertError> {
        let (role, entity) = (self.role()?, self.entity.name()?);
        Ok(RecordKey { name: self.name, role, entity, switch: self.switch })
    }

    /// Returns the entity's role for the name. The result is unverified until the record is
    /// [verified](Self::verify).
    pub fn role(&self) -> Result<NameRole, CertError> {
        let op = self.advert.claims_unverified()?.op;
        NameRole::of(op).ok_or_else(|| CertError::Malformed("a record of a withdrawal".into()))
    }

    /// Verifies the record from scratch.
    ///
    /// It checks the derivation of both names and the entity's own statement. It checks the
    /// credential at `now` (Unix seconds) under the newest known revocation of the name.
    /// [`Credential::check_member`] checks revocations by domains.
    pub fn verify(&self, revocation: Option<&Revocation>, now: u64) -> Result<Verified, CertError> {
        let name = self.proof.name()?;
        if name != self.name {
            return Err(CertError::WrongName { expected: self.name, got: name });
        }
        let entity = self.entity.name()?;
        let (side, not_after) = match &self.credential {
            Credential::Writer(cert) => {
                let cert = cert.verify(&self.proof, revocation, now)?;
                if cert.entity != entity {
                    return Err(CertError::WrongEntity { expected: entity, got: cert.entity });
                }
                (Side::Writer, cert.not_after)
            }
            Credential::Reader(grant) => (Side::Reader, grant.verify(&self.proof, entity, revocation, now)?.not_after),
        };
        let key = self.entity.verify_key()?;
        let advert = verify_statement(&self.advert, side, name, (entity, &key), self.switch)?;
        Ok(Verified { entity, advert, not_after })
    }

    /// Returns whether this is an advertisement rather than a subscription.
    pub fn is_writer(&self) -> bool {
        matches!(self.credential, Credential::Writer(_))
    }
}
