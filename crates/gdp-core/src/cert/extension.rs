//! Fields of a payload that this release does not know. Later releases may add some to any kind of
//! certificate. A verifier skips them, unless the payload lists them as critical. The rule is that
//! of the `crit` parameter of RFC 9052 §3.1.

use super::Claims;
use crate::cbor::Value;
use crate::cert::error::CertError;

/// Field with the array of the names of those fields that a verifier must know.
const CRITICAL: &str = "critical";

/// Maximum number of characters of an unknown name in an error.
const MAX_SHOWN: usize = 64;

/// Checks that none of the unknown fields is critical.
pub fn check<T: Claims>(unknown: &[(Value, Value)]) -> Result<(), CertError> {
    let find = |name: &str| unknown.iter().find(|(key, _)| key.as_text() == Some(name));
    let Some((_, critical)) = find(CRITICAL) else { return Ok(()) };
    let malformed = || CertError::Malformed(format!("its field {CRITICAL:?} is not an array of names"));
    for name in critical.as_array().ok_or_else(malformed)? {
        let name = name.as_text().ok_or_else(malformed)?;
        if find(name).is_some() {
            let field = format!("{:?}", name.chars().take(MAX_SHOWN).collect::<String>());
            return Err(CertError::UnknownField { what: T::KIND, field });
        }
    }
    Ok(())
}
