//! The proof of a domain name in the file of a certificate.

use super::error::CertError;
use crate::name::Name;

/// Between `-----BEGIN ` and `-----` in a name proof's text form.
pub(super) const PROOF_LABEL: &str = "GDP NAME PROOF";

/// A name proof in CBOR has 89 bytes.
pub(super) const MAX_PROOF: usize = 128;

pub(super) fn expect_domain(expected: Name, got: Name) -> Result<(), CertError> {
    if expected == got { Ok(()) } else { Err(CertError::WrongDomain { expected, got }) }
}
