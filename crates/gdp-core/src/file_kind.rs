//! Recognises this project's files by their text, for the error about a file in the wrong place.

use std::fmt;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    Key,
    Card,
    Invitation,
    AdCert,
    ReadGrant,
    Delegation,
    Revocation,
    Membership,
    PeerCert,
    RtCert,
}

/// Certificates, each with its PEM label and with its purpose.
const CERTIFICATES: [(FileKind, &str, &str); 7] = [
    (FileKind::AdCert, "GDP AD CERT", "a certificate to publish"),
    (FileKind::ReadGrant, "GDP READ GRANT", "a grant to read"),
    (FileKind::Delegation, "GDP DELEGATION", "a delegation"),
    (FileKind::Revocation, "GDP REVOCATION", "a revocation"),
    (FileKind::Membership, "GDP MEMBER CERT", "a membership of a domain"),
    (FileKind::PeerCert, "GDP PEER CERT", "a grant of rights to another domain"),
    (FileKind::RtCert, "GDP RT CERT", "a certificate for a switch"),
];

impl FileKind {
    /// Returns the kind of a file with this text. Nothing of the text is verified.
    pub fn of(text: &str) -> Option<Self> {
        let text = text.trim_ascii_start();
        if text.starts_with("gdp1") {
            return Some(Self::Invitation);
        }
        if text.starts_with('{') {
            return text.contains("\"owner_key\"").then_some(Self::Card);
        }
        let (found, _) = text.split_once("-----BEGIN ")?.1.split_once("-----")?;
        if found.ends_with("PRIVATE KEY") {
            return Some(Self::Key);
        }
        of_label(found)
    }
}

/// Returns the kind of a certificate with this PEM label.
pub fn of_label(label: &str) -> Option<FileKind> {
    CERTIFICATES.iter().find(|(_, known, _)| *known == label).map(|(kind, ..)| *kind)
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match CERTIFICATES.iter().find(|(kind, ..)| kind == self) {
            Some((_, label, purpose)) => write!(f, "{purpose} ({label})"),
            None if *self == Self::Key => f.write_str("a private key"),
            None if *self == Self::Card => f.write_str("a name card"),
            None => f.write_str("an invitation"),
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/file_kind.rs"]
mod tests;
