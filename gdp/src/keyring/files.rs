//! Certificate files of a keyring.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use gdp_core::cert::{AdCert, CertError, Claims as _, Issued, MAX_CERT_FILE, ReadGrant, Reading};
use gdp_core::file_kind::FileKind;

/// A certificate by which an entity publishes or reads a name.
pub enum RightFile {
    Publish(Issued<AdCert>),
    Read(Reading),
}

/// Reads a certificate. The error is for people, and does not name the file.
pub fn read(file: &Path) -> Result<RightFile, String> {
    let mut text = String::new();
    let opened = File::open(file).map_err(|error| format!("cannot open it: {error}"))?;
    let read = opened.take(MAX_CERT_FILE as u64 + 1).read_to_string(&mut text);
    read.map_err(|error| format!("cannot read it as text: {error}"))?;
    let begins = |label: &str| text.trim_ascii_start().starts_with(&format!("-----BEGIN {label}-----"));
    let wrong = |error: CertError| error.to_string();
    match () {
        () if begins(AdCert::LABEL) => Issued::from_pem(&text).map(RightFile::Publish).map_err(wrong),
        () if begins(ReadGrant::LABEL) => Reading::from_pem(&text).map(RightFile::Read).map_err(wrong),
        () => Err(match FileKind::of(&text) {
            Some(kind) => format!("it is {kind}, and no certificate to publish or to read"),
            None => "no certificate to publish or to read; `gdp-ctl cert show` tells what it is".to_owned(),
        }),
    }
}
