//! Checks that a request must pass before anything is stored. They cover the derivation of the
//! name, the certificate, the entity's own statement, and that all concern the same name, entity
//! and switch. Scope and transit rights between domains are checked at the border between domains,
//! not here.

use super::issued::{expect_entity, expect_name};
use super::{AdCert, Advert, AdvertOp, Issued, ReadGrant, Reading, Revocation, Signed};
use crate::cert::error::CertError;
use crate::name::{Name, NameProof};
use crate::verify_key::VerifyKey;

/// Authenticated requester, identified by its link or an earlier verification, and the time of the
/// request.
#[derive(Clone, Debug)]
pub struct Requester {
    pub entity: Name,
    pub entity_key: VerifyKey,
    /// Switch to which the requester is attached.
    pub switch: Name,
    /// Highest serial seen of the entity. A statement must exceed it.
    pub floor: u64,
    /// Unix time in seconds.
    pub now: u64,
}

/// Verifies that `speaker` may publish or serve the name in `proof`. `revocation` is the newest
/// known one of the name. Returns the certificate, with the validity of its chain, and the
/// statement.
pub fn authorise_advertise(
    speaker: &Requester,
    proof: &NameProof,
    cert: &Issued<AdCert>,
    advert: &Signed<Advert>,
    revocation: Option<&Revocation>,
) -> Result<(AdCert, Advert), CertError> {
    let claims = cert.verify(proof, revocation, speaker.now)?;
    expect_entity(speaker.entity, claims.entity)?;
    let advert = speaker.verify_statement(claims.name, Side::Writer, advert)?;
    Ok((claims, advert))
}

/// Verifies that `speaker` may subscribe to or call the name in `proof`, as [`authorise_advertise`]
/// does.
pub fn authorise_subscribe(
    speaker: &Requester,
    proof: &NameProof,
    grant: &Reading,
    advert: &Signed<Advert>,
    revocation: Option<&Revocation>,
) -> Result<(ReadGrant, Advert), CertError> {
    let claims = grant.verify(proof, speaker.entity, revocation, speaker.now)?;
    let advert = speaker.verify_statement(claims.name, Side::Reader, advert)?;
    Ok((claims, advert))
}

/// Verifies a withdrawal. An entity may always withdraw its own statements.
pub fn authorise_withdraw(speaker: &Requester, advert: &Signed<Advert>) -> Result<Advert, CertError> {
    let name = advert.claims_unverified()?.name;
    speaker.verify_statement(name, Side::Neither, advert)
}

impl Requester {
    fn verify_statement(&self, name: Name, side: Side, advert: &Signed<Advert>) -> Result<Advert, CertError> {
        let advert = verify_statement(advert, side, name, (self.entity, &self.entity_key), self.switch)?;
        if advert.serial <= self.floor {
            return Err(CertError::ReplayedSerial { got: advert.serial, floor: self.floor });
        }
        Ok(advert)
    }
}

/// Kind of right that a statement needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The right of an AdCert.
    Writer,
    /// The right of a ReadGrant.
    Reader,
    /// No right, for a withdrawal.
    Neither,
}

impl Side {
    fn of(op: AdvertOp) -> Self {
        match op {
            AdvertOp::Publish | AdvertOp::Serve => Self::Writer,
            AdvertOp::Subscribe | AdvertOp::Call => Self::Reader,
            AdvertOp::Withdraw => Self::Neither,
        }
    }

    fn ops(self) -> &'static str {
        match self {
            Self::Writer => "publish or serve",
            Self::Reader => "subscribe or call",
            Self::Neither => "withdraw",
        }
    }
}

/// Verifies that `entity` itself made this statement about `name` at `switch`, and that it needs
/// the right of this side.
pub fn verify_statement(
    advert: &Signed<Advert>,
    side: Side,
    name: Name,
    (entity, key): (Name, &VerifyKey),
    switch: Name,
) -> Result<Advert, CertError> {
    // A statement is bounded by its serial and its lifetime, not by a time of its own.
    let advert = advert.verify_signature(key)?;
    if Side::of(advert.op) != side {
        return Err(CertError::WrongOperation { expected: side.ops(), got: advert.op });
    }
    expect_name(name, advert.name)?;
    expect_entity(entity, advert.entity)?;
    if advert.switch != switch {
        return Err(CertError::WrongSwitch { expected: switch, got: advert.switch });
    }
    Ok(advert)
}
