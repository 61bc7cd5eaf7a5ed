//! The checks that a publish, subscribe or withdraw must pass before anything is stored: derivation of the name, the
//! owner's certificate, the entity's own statement, and that all of them are about the same name, entity and switch.
//! Scope and transit rights between domains are checked where domains meet, not here.

use super::{AdCert, Advert, AdvertOp, CertError, Claims, ReadGrant, Signed};
use crate::identity::VerifyKey;
use crate::name::{Name, NameProof};

/// Who asks, as its link or an earlier verification showed, and when.
#[derive(Clone, Debug)]
pub struct Speaker {
    pub entity: Name,
    pub entity_key: VerifyKey,
    /// The switch it is attached to.
    pub switch: Name,
    /// The highest serial seen of the entity: a statement must be above it.
    pub floor: u64,
    /// Unix seconds.
    pub now: u64,
}

/// May `speaker` publish the name that `proof` shows? Returns the name's certificate and the statement.
pub fn authorise_publish(
    speaker: &Speaker,
    proof: &NameProof,
    cert: &Signed<AdCert>,
    advert: &Signed<Advert>,
) -> Result<(AdCert, Advert), CertError> {
    let (name, claims) = verify_from_owner(speaker, proof, cert, |c| (c.name, c.entity))?;
    Ok((claims, verify_statement(speaker, name, AdvertOp::Publish, advert)?))
}

/// May `speaker` subscribe to the name that `proof` shows?
pub fn authorise_subscribe(
    speaker: &Speaker,
    proof: &NameProof,
    grant: &Signed<ReadGrant>,
    advert: &Signed<Advert>,
) -> Result<(ReadGrant, Advert), CertError> {
    let (name, claims) = verify_from_owner(speaker, proof, grant, |c| (c.name, c.entity))?;
    Ok((claims, verify_statement(speaker, name, AdvertOp::Subscribe, advert)?))
}

/// An entity may always withdraw what it stated itself.
pub fn authorise_withdraw(speaker: &Speaker, advert: &Signed<Advert>) -> Result<Advert, CertError> {
    let name = advert.claims_unverified()?.name;
    verify_statement(speaker, name, AdvertOp::Withdraw, advert)
}

fn verify_from_owner<T: Claims>(
    speaker: &Speaker,
    proof: &NameProof,
    cert: &Signed<T>,
    subject: impl Fn(&T) -> (Name, Name),
) -> Result<(Name, T), CertError> {
    let name = proof.name()?;
    let claims = cert.verify(&proof.verify_key()?, speaker.now)?;
    let (certified_name, certified_entity) = subject(&claims);
    expect_name(certified_name, name)?;
    expect_entity(speaker.entity, certified_entity)?;
    Ok((name, claims))
}

fn verify_statement(speaker: &Speaker, name: Name, op: AdvertOp, advert: &Signed<Advert>) -> Result<Advert, CertError> {
    let advert = advert.verify(&speaker.entity_key, speaker.now)?;
    if advert.op != op {
        return Err(CertError::WrongOperation { expected: op, got: advert.op });
    }
    expect_name(name, advert.name)?;
    expect_entity(speaker.entity, advert.entity)?;
    if advert.switch != speaker.switch {
        return Err(CertError::WrongSwitch { expected: speaker.switch, got: advert.switch });
    }
    if advert.serial <= speaker.floor {
        return Err(CertError::ReplayedSerial { got: advert.serial, floor: speaker.floor });
    }
    Ok(advert)
}

fn expect_name(expected: Name, got: Name) -> Result<(), CertError> {
    if expected == got { Ok(()) } else { Err(CertError::WrongName { expected, got }) }
}

fn expect_entity(expected: Name, got: Name) -> Result<(), CertError> {
    if expected == got { Ok(()) } else { Err(CertError::WrongEntity { expected, got }) }
}
