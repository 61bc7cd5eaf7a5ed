//! Certificates of later and earlier releases. An issuer of the test composes them with `coset`, as
//! another implementation would, and publishes them as `docs/vectors/cert.json`.

use super::*;
use crate::cbor::{self, Value};
use crate::crypto::Backend;
use crate::identity::SigningKey;
use crate::name::Name;
use coset::TaggedCborSerializable;
use serde_json::json;

const NOW: u64 = 1_800_000_000;

#[test]
fn unknown_fields_are_skipped_unless_they_are_critical() {
    let owner = SigningKey::from_secret_bytes(&[1; 32]).unwrap();
    let claims = claims();
    let fields = |others: &[(&str, Value)]| {
        let Value::Map(mut fields) = Value::serialized(&claims).unwrap() else { panic!("a map") };
        fields.extend(others.iter().map(|(name, value)| (Value::from(*name), value.clone())));
        cbor::encode(&Value::Map(fields)).unwrap()
    };
    let names = |names: &[&str]| Value::Array(names.iter().map(|name| Value::from(*name)).collect());
    let unknown = |field: &str| Err(CertError::UnknownField { what: "AdCert", field: format!("{field:?}") });
    let malformed = || Err(CertError::Malformed(r#"its field "critical" is not an array of names"#.into()));
    let wrong_name = |text: &str| Err(CertError::Malformed(text.into()));

    let context = AdCert::CONTEXT;
    let mut unsorted = fields(&[]);
    // The fields are those of the text keys, of which "name" comes first and the rest moves.
    let first = unsorted.remove(0);
    unsorted.rotate_left(5 + 34);
    unsorted.insert(0, first);
    let cases = [
        ("no unknown field", context, fields(&[]), Ok(())),
        ("an unknown field is skipped", context, fields(&[("max_rate", 50.into())]), Ok(())),
        (
            "of two unknown fields none is critical",
            context,
            fields(&[("critical", names(&[])), ("max_rate", 50.into()), ("note", "spare".into())]),
            Ok(()),
        ),
        (
            "a critical field that this release does not know",
            context,
            fields(&[("critical", names(&["geofence"])), ("geofence", "yard".into()), ("note", "spare".into())]),
            unknown("geofence"),
        ),
        ("a critical field that this release knows", context, fields(&[("critical", names(&["scope"]))]), Ok(())),
        ("what is critical is not a list", context, fields(&[("critical", true.into())]), malformed()),
        ("what is critical is not a name", context, fields(&[("critical", Value::Array(vec![1.into()]))]), malformed()),
        (
            "the first format version",
            "application/vnd.gdp.ad-cert.v1+cbor",
            fields(&[]),
            Err(CertError::OldVersion { what: "AdCert" }),
        ),
        (
            "an unknown kind",
            "application/vnd.gdp.tow-cert.v2+cbor",
            fields(&[]),
            wrong_name(
                "expected AdCert (application/vnd.gdp.ad-cert.v2+cbor), found application/vnd.gdp.tow-cert.v2+cbor",
            ),
        ),
        (
            "fields in another order",
            context,
            unsorted,
            wrong_name("not deterministic CBOR (RFC 8949 §4.2.1): one value must have one encoding"),
        ),
    ];
    let vectors = cases.map(|(description, context, payload, expected)| {
        let bytes = sign(&owner, context, payload);
        let got = Signed::<AdCert>::from_bytes(bytes.clone()).unwrap().verify(&owner.verify_key(), NOW);
        assert_eq!(got, expected.clone().map(|()| claims.clone()), "{description}");
        json!({
            "description": description,
            "bytes": hex::encode(bytes),
            "refused": expected.err().map(|error| error.to_string()),
        })
    });
    let high = Signed::<AdCert>::from_bytes(high_s(sign(&owner, context, fields(&[])))).unwrap();
    let refused = high.verify(&owner.verify_key(), NOW).unwrap_err();
    assert_eq!(refused, CertError::HighS { what: "AdCert" });
    crate::vectors::check(
        "cert.json",
        &json!({
            "about": "AdCerts, signed by the P-256 private key 0x0101...01 with RFC 6979 nonces; refused: null if \
                the certificate holds, otherwise what this implementation says",
            "now": NOW,
            "owner_key": hex::encode(owner.public()),
            "claims": claims,
            "vectors": vectors,
            "high_s": { "bytes": hex::encode(high.as_bytes()), "refused": refused.to_string() },
        }),
    );
}

/// A file may have blocks of later kinds. Their label says whether they may be skipped.
#[test]
fn unknown_blocks_of_a_file_are_skipped_if_they_are_optional_and_refused_by_name_otherwise() {
    let owner = SigningKey::from_secret_bytes(&[1; 32]).unwrap();
    let cert = Issued::from(issue(&owner, &claims()).unwrap());
    let block = |label: &str| format!("-----BEGIN {label}-----\nAAAA\n-----END {label}-----\n");
    let optional = block("GDP OPTIONAL TOW CERT");
    for text in [cert.to_pem() + &optional, optional.clone() + &cert.to_pem(), optional.repeat(5) + &cert.to_pem()] {
        assert_eq!(Issued::from_pem(&text).as_ref(), Ok(&cert), "{text}");
    }
    for (text, named) in [
        (cert.to_pem() + &block("GDP TOW CERT"), "GDP TOW CERT"),
        (block("GDP TOW CERT") + &cert.to_pem(), "GDP TOW CERT"),
        (optional.clone(), "nothing"),
        (optional.repeat(8) + &cert.to_pem(), "more than 7 blocks"),
    ] {
        let error = Issued::<AdCert>::from_pem(&text).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
}

fn claims() -> AdCert {
    let [name, entity] = [2, 3].map(|byte| Name::from_bytes([byte; 32]));
    let serial = NOW * 1_000_000_000;
    AdCert { name, entity, scope: vec![], serial, not_before: NOW, not_after: NOW + 60 }
}

fn sign(key: &SigningKey, context: &str, payload: Vec<u8>) -> Vec<u8> {
    let protected = coset::HeaderBuilder::new()
        .algorithm(coset::iana::Algorithm::ES256)
        .content_type(context.into())
        .key_id(key.public().to_vec())
        .build();
    let signer = key.signer(Backend::RustCrypto).unwrap();
    let builder = coset::CoseSign1Builder::new().protected(protected).payload(payload);
    let signed = builder.create_signature(context.as_bytes(), |message| signer.sign(message).unwrap().to_vec());
    signed.build().to_tagged_vec().unwrap()
}

fn high_s(mut bytes: Vec<u8>) -> Vec<u8> {
    let signature = bytes.last_chunk_mut().unwrap();
    *signature = crate::crypto::tests::restated(signature);
    bytes
}
