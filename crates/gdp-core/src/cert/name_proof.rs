//! Proof of a domain's name in the file of a certificate.

use super::error::CertError;
use crate::name::Name;

/// Label of a name proof's text form, between `-----BEGIN ` and `-----`.
pub(super) const PROOF_LABEL: &str = "GDP NAME PROOF";

/// Maximum bytes of a name proof in CBOR, which actually has 89.
pub(super) const MAX_PROOF: usize = 128;

pub(super) fn expect_domain(expected: Name, got: Name) -> Result<(), CertError> {
    if expected == got { Ok(()) } else { Err(CertError::WrongDomain { expected, got }) }
}
