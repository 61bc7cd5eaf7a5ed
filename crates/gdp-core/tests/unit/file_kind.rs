//! Unit tests of `file_kind`.

use super::*;
use crate::card::NameCard;
use crate::cert::{AdCert, Claims, Delegation, MemberCert, PeerCert, ReadGrant, Revocation, RtCert};
use crate::identity::{Identity, SigningKey};

#[test]
fn a_file_is_recognised_by_its_text() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.pem");
    Identity::generate("proxy").unwrap().save_new(&path).unwrap();
    let key = std::fs::read_to_string(&path).unwrap();
    let owner = SigningKey::generate().unwrap().verify_key();
    let card = NameCard::create(owner, "topic", "/a", "a/msg/A", None).unwrap().to_json();
    for (text, expected) in [
        (key.as_str(), Some("a private key")),
        (&card, Some("a name card")),
        ("-----BEGIN EC PRIVATE KEY-----\n", Some("a private key")),
        ("\n-----BEGIN GDP AD CERT-----\nAAAA", Some("a certificate to publish (GDP AD CERT)")),
        ("-----BEGIN GDP READ GRANT-----\n", Some("a grant to read (GDP READ GRANT)")),
        ("gdp1AAAA", Some("an invitation")),
        ("-----BEGIN CERTIFICATE-----\n", None),
        ("{\"a\": 1}", None),
        ("version: 1\n", None),
        ("", None),
    ] {
        assert_eq!(FileKind::of(text).map(|kind| kind.to_string()).as_deref(), expected, "{text}");
    }
}

#[test]
fn the_labels_are_those_of_the_certificates() {
    let labels = CERTIFICATES.map(|(_, label, _)| label);
    let owners = [AdCert::LABEL, ReadGrant::LABEL, Delegation::LABEL, Revocation::LABEL];
    let others = [MemberCert::LABEL, PeerCert::LABEL, RtCert::LABEL];
    assert_eq!(labels[..], [&owners[..], &others].concat());
}
