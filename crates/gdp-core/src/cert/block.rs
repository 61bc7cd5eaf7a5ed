//! One block of RFC 7468: its label and its content.

use crate::cert::error::CertError;
use crate::file_kind;
use p256::pkcs8::der::pem;

/// Decodes one block, which must have this label.
pub fn decode_block(label: &str, text: &str) -> Result<Vec<u8>, CertError> {
    // The decoder's errors are about its own steps.
    let (found, bytes) = pem::decode_vec(text.trim_ascii_start().as_bytes()).map_err(|_| {
        CertError::Malformed(format!("the text after \"BEGIN {label}\" is damaged; copy the whole file again"))
    })?;
    if found == label { Ok(bytes) } else { Err(wrong_label(label, Some(found))) }
}

/// Returns the error of a block with another label than the expected one, or of none.
pub fn wrong_label(expected: &str, found: Option<&str>) -> CertError {
    let what = |label: &str| file_kind::of_label(label).map_or_else(|| label.to_owned(), |kind| kind.to_string());
    let found = found.map_or_else(|| "nothing more".into(), what);
    CertError::Malformed(format!("{found}, where {} is expected", what(expected)))
}
