//! One statement with the certificates that authorise it, as a RIB stores it.

use crate::control::role::NameRole;
use gdp_core::cert::{
    AdCert, Advert, CertError, Issued, Membership, Reading, Revocation, Side, Signed, verify_statement,
};
use gdp_core::name::NameProof;
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

/// One verified advertisement or subscription, with all that is needed to verify it again.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    pub name: Name,
    /// How `name` is derived, and the owner's key.
    pub proof: NameProof,
    /// How the name of the entity is derived, and its key.
    pub entity: NameProof,
    /// The switch the entity is attached to.
    pub switch: Name,
    pub credential: Credential,
    /// What the entity itself stated.
    pub advert: Signed<Advert>,
    /// Seconds until the record ends by itself, on the clock of who answers.
    pub expires_in: u64,
}

/// What the owner of a name gave an entity: it also tells what the entity is to the name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Credential {
    Writer(Issued<AdCert>),
    Reader(Reading),
}

impl Credential {
    /// Bytes of what is signed in it.
    pub fn size(&self) -> usize {
        match self {
            Self::Writer(cert) => cert.size(),
            Self::Reader(grant) => grant.size(),
        }
    }

    /// Domains that a writer may be known in besides its own; a reader's credential names none.
    /// Believe it once the credential is verified.
    pub fn scope(&self) -> Result<Vec<Name>, CertError> {
        match self {
            Self::Writer(cert) => Ok(cert.cert.claims_unverified()?.scope),
            Self::Reader(_) => Ok(Vec::new()),
        }
    }

    /// The membership that it asks for, if it asks for one.
    pub fn member(&self) -> Option<&Membership> {
        match self {
            Self::Writer(_) => None,
            Self::Reader(grant) => grant.member.as_deref(),
        }
    }

    /// As [`Reading::check_member`]; a writer needs no membership.
    pub fn check_member<'a>(&self, newest: impl FnOnce(&Name) -> Option<&'a Revocation>) -> Result<(), CertError> {
        match self {
            Self::Writer(_) => Ok(()),
            Self::Reader(grant) => grant.check_member(newest),
        }
    }

    /// Of what a revocation can take back: what it is, and its serial. Believe it once the
    /// credential is verified.
    pub fn serials(&self) -> Result<Vec<(&'static str, u64)>, CertError> {
        match self {
            Self::Writer(cert) => cert.serials(),
            Self::Reader(reading) => reading.grant.serials(),
        }
    }
}

/// What a record is worth once it verified.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verified {
    pub entity: Name,
    pub advert: Advert,
    /// When the credential's chain ends, in Unix seconds.
    pub not_after: u64,
}

/// A record's place in the order in which a RIB lists them: by name, of each its writers before its
/// readers; of those one at each of its switches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RecordKey {
    pub name: Name,
    pub role: NameRole,
    pub entity: Name,
    pub switch: Name,
}

impl Record {
    /// Where the record is listed; an error if the entity's key is not one, or the statement none
    /// that is listed.
    pub fn place(&self) -> Result<RecordKey, CertError> {
        let (role, entity) = (self.role()?, self.entity.name()?);
        Ok(RecordKey { name: self.name, role, entity, switch: self.switch })
    }

    /// What the entity says it is to the name. Believe it once the record is
    /// [verified](Self::verify).
    pub fn role(&self) -> Result<NameRole, CertError> {
        let op = self.advert.claims_unverified()?.op;
        NameRole::of(op).ok_or_else(|| CertError::Malformed("a record of a withdrawal".into()))
    }

    /// Verifies the record as if nobody had before: derivation of both names, the credential at
    /// `now` (Unix seconds) under the newest revocation that is known of the name, and the entity's
    /// own statement. What domains have taken back, [`Credential::check_member`] says.
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

    /// Whether this is an advertisement (and not a subscription).
    pub fn is_writer(&self) -> bool {
        matches!(self.credential, Credential::Writer(_))
    }
}
