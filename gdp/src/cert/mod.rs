//! Certificates and statements: COSE_Sign1 / ES256 over deterministic CBOR (RFC 9052, RFC 8949 §4.2.1). [`claims`] says
//! what they state, [`Signed`] keeps and checks the exact bytes. Who must have signed what for a request to be
//! granted is checked in [`request`]. The RIB, and whoever receives its answers, call this.
//!
//! Domain separation: the type of a certificate is its external AAD and its protected content type, so one type never
//! verifies as another; a COSE `Sig_structure` begins with a CBOR array head and "Signature1", which no other input that
//! this project signs begins with (`gdp::seal` signs "gdp/batch/1…", TLS signs 64 spaces and a context).

mod claims;
mod request;
mod signed;

pub use claims::{AdCert, Advert, AdvertOp, Claims, MAX_SCOPE, Mode, ReadGrant, RtCert, Validity};
pub use request::{Speaker, authorise_publish, authorise_subscribe, authorise_withdraw};
pub use signed::{MAX_SIGNED, Signed, issue};

use crate::cbor::CborError;
use crate::crypto::CryptoError;
use crate::name::Name;

/// Why a certificate or statement is refused. The display names what is wrong and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CertError {
    #[error("bad signature: the {what} was changed after it was signed")]
    BadSignature { what: &'static str },
    #[error("wrong key: the {what} was signed by {got}, but must be signed by {expected}; sign it with that key")]
    WrongKey { what: &'static str, expected: String, got: String },
    #[error("not yet valid: begins at Unix time {from}, now is {now}; wait, or check the clock")]
    NotYetValid { from: u64, now: u64 },
    #[error("expired at Unix time {at}, now is {now}; have a new one issued, or check the clock")]
    Expired { at: u64, now: u64 },
    #[error("malformed certificate: {0}")]
    Malformed(String),
    #[error(
        "wrong name: {got} where {expected} is expected; the digest, the owner key or the certificate is of another name"
    )]
    WrongName { expected: Name, got: Name },
    #[error("wrong entity: the certificate or statement is of {got}, not of {expected}; use the one for this entity")]
    WrongEntity { expected: Name, got: Name },
    #[error(
        "wrong switch: the certificate or statement is for {got}, not for {expected}; attach to that one, or sign anew"
    )]
    WrongSwitch { expected: Name, got: Name },
    #[error("wrong operation: the statement says {got}, the request needs {expected}")]
    WrongOperation { expected: AdvertOp, got: AdvertOp },
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

#[cfg(test)]
mod tests;
