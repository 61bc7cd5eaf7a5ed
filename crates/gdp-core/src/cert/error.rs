//! Reasons why a certificate or statement is refused.

use crate::cbor::CborError;
use crate::cert::advert_op::AdvertOp;
use crate::crypto::CryptoError;
use crate::name::Name;
use gdp_util::date::relative;

/// Reason why a certificate or statement is refused. The display names what is wrong and what to do
/// about it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CertError {
    #[error("bad signature: the {what} was changed after it was signed")]
    BadSignature { what: &'static str },
    #[error("high s: the {what} has the form of signature that anybody can make of another; have it issued anew")]
    HighS { what: &'static str },
    #[error("format version 1: the {what} is of the first format, which nobody reads any more; have it issued anew")]
    OldVersion { what: &'static str },
    #[error(
        "unknown critical field: the {what} has {field}, which this release does not know and must not skip; upgrade \
         this side"
    )]
    UnknownField { what: &'static str, field: String },
    #[error("wrong key: the {what} was signed by {got}, but must be signed by {expected}; sign it with that key")]
    WrongKey { what: &'static str, expected: String, got: String },
    #[error("not yet valid: begins {}; wait, or check the clock", relative(*from, *now))]
    NotYetValid { from: u64, now: u64 },
    #[error(
        "issued later: the {what} with serial {serial} was issued {}; have it issued anew, or check the clock",
        relative(serial / 1_000_000_000, *now)
    )]
    IssuedLater { what: &'static str, serial: u64, now: u64 },
    #[error("expired {}; have a new one issued, or check the clock", relative(*at, *now))]
    Expired { at: u64, now: u64 },
    #[error("malformed certificate: {0}")]
    Malformed(String),
    #[error(
        "wrong name: {got} where {expected} is expected; the digest, the owner key or the certificate is of another \
         name"
    )]
    WrongName { expected: Name, got: Name },
    #[error("wrong entity: the certificate or statement is of {got}, not of {expected}; use the one for this entity")]
    WrongEntity { expected: Name, got: Name },
    #[error(
        "wrong switch: the certificate or statement is for {got}, not for {expected}; attach to that one, or sign anew"
    )]
    WrongSwitch { expected: Name, got: Name },
    #[error("wrong operation: the statement says {got}, the request needs {expected}")]
    WrongOperation { expected: &'static str, got: AdvertOp },
    #[error("wrong domain: {got} where {expected} is expected; use the certificate of that one")]
    WrongDomain { expected: Name, got: Name },
    #[error("not a domain: {name} is the name of a {kind}, which has no members; name the domain by its card")]
    NotADomain { name: Name, kind: &'static str },
    #[error("wrong role: the member certificate gives role {got}, where {expected} is asked for")]
    WrongRole { expected: String, got: String },
    #[error(
        "not shown to be a member: the grant is for role {role} of domain {domain}; add that domain's member \
         certificate"
    )]
    NotAMember { role: String, domain: Name },
    #[error(
        "admitted by invitation: the grant is for role {role} of domain {domain}, whose key itself must say who has \
         it; have \
         the reader admitted with `gdp-ctl domain admit`"
    )]
    ByInvitation { role: String, domain: Name },
    #[error(
        "not delegated: the owner lets {delegate} issue no {what}; have the owner issue it, or widen the delegation"
    )]
    NotDelegated { what: &'static str, delegate: String },
    #[error(
        "issued before its delegation: the {what} has serial {serial}, the delegation {delegation}; issue it anew, or \
         check the clock"
    )]
    BeforeDelegation { what: &'static str, serial: u64, delegation: u64 },
    #[error(
        "revoked: the {what} with serial {serial} no longer holds by revocation {number} of its owner (floor {floor}); \
         have a new one issued"
    )]
    Revoked { what: &'static str, serial: u64, floor: u64, number: u64 },
    #[error(
        "signed by a retired key: the {what} must be signed by {signer}, which succeeded it; have a new one issued"
    )]
    Retired { what: &'static str, signer: String },
    #[error(
        "rolled back: revocation {got} does not replace {known}, the highest known; publish one with a higher number"
    )]
    RolledBack { got: u64, known: u64 },
    #[error(
        "replayed serial: {got} is not above {floor}, the highest seen of this entity; sign anew with a higher serial"
    )]
    ReplayedSerial { got: u64, floor: u64 },
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}

impl From<CborError> for CertError {
    fn from(error: CborError) -> Self {
        Self::Malformed(error.to_string())
    }
}
