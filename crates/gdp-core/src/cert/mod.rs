//! Certificates and statements: COSE_Sign1 / ES256 over deterministic CBOR (RFC 9052, RFC 8949 §4.2.1). [`owner`], [`domain`],
//! [`switch`], [`statements`] and [`link_state`] say what they state, [`Signed`] keeps and checks the exact bytes, [`issued`] the chain from a certificate
//! to the owner of its name. Who must have signed what for a request to be granted is checked in [`request`]. The RIB, and
//! whoever receives its answers, call this.
//!
//! Domain separation: the type of a certificate is its external AAD and its protected content type, so one type never
//! verifies as another; a COSE `Sig_structure` begins with a CBOR array head and "Signature1", which no other input that
//! this project signs begins with (`gdp::seal` signs "gdp/batch/1…", TLS signs 64 spaces and a context).

mod claims;
pub mod domain;
mod issued;
mod link_state;
mod owner;
mod pem;
mod request;
mod signed;
mod statements;
mod switch;

pub use claims::{CLOCKS_DIFFER, Claims, Validity};
pub use domain::{Invite, MemberCert, Membership, PeerCert, PeerRights};
pub use issued::{Issued, MAX_CERT_FILE, Reading};
pub use link_state::{Adjoining, LinkState, MAX_BORDERS, MAX_NEIGHBOURS};
pub use owner::{
    AboutName, AdCert, Delegation, Grantee, MAX_REVOKED, MAX_ROLE, MAX_SCOPE, Mode, ReadGrant, Revocation,
};
pub use request::{Side, verify_statement};
pub use request::{Speaker, authorise_advertise, authorise_subscribe, authorise_withdraw};
pub use signed::{MAX_SIGNED, Signed, issue};
pub use statements::{Advert, AdvertOp, RtCert};
pub use switch::{Host, Locator, MAX_ADDRESSES, MAX_LOCATED, MAX_LOCATOR, SwitchStatement};

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
    WrongOperation { expected: &'static str, got: AdvertOp },
    #[error("wrong domain: {got} where {expected} is expected; use the certificate of that one")]
    WrongDomain { expected: Name, got: Name },
    #[error("wrong role: the member certificate gives role {got}, where {expected} is asked for")]
    WrongRole { expected: String, got: String },
    #[error(
        "not shown to be a member: the grant is for role {role} of domain {domain}; add that domain's member certificate"
    )]
    NotAMember { role: String, domain: Name },
    #[error(
        "admitted by invitation: the grant is for role {role} of domain {domain}, whose key itself must say who has it; have \
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
        "rolled back: revocation {got} does not replace {held}, the highest known; publish one with a higher number"
    )]
    RolledBack { got: u64, held: u64 },
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
#[path = "../../tests/unit/cert/issued_tests.rs"]
mod issued_tests;
#[cfg(test)]
#[path = "../../tests/unit/cert/switch_tests.rs"]
mod switch_tests;
#[cfg(test)]
#[path = "../../tests/unit/cert.rs"]
mod tests;
