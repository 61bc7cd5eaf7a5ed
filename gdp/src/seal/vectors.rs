//! The published test vectors of names and segments. Signatures in them are those of RFC 6979, so that the vectors are the same on every run.

use super::*;
use crate::crypto::Backend;
use crate::identity::SigningKey;
use crate::name::{self, Metadata, Name};
use crate::vectors::check;
use serde_json::json;

#[test]
fn vectors_of_names() {
    let cases = [
        ("the empty map", Metadata::new()),
        (
            "a topic",
            map(&[
                ("kind", "topic"),
                ("topic", "/chatter"),
                ("type", "std_msgs/msg/String"),
                ("nonce", "000102030405060708090a0b0c0d0e0f"),
            ]),
        ),
        ("an entity", map(&[("kind", "switch")])),
        ("escapes", map(&[("quote\"", "back\\slash /\u{8}\t\n\u{c}\r\u{1}\u{7f}")])),
        (
            "keys ordered by UTF-16 code units, not by code points",
            map(&[
                ("\u{fb33}", "Hebrew letter dalet with dagesh"),
                ("\u{1f600}", "grinning face"),
                ("\u{20ac}", "euro"),
                ("a", ""),
            ]),
        ),
    ];
    let owner = SigningKey::for_test(1).public();
    let vectors = cases.map(|(description, metadata)| {
        let digest = name::inner_digest(&metadata);
        json!({
            "description": description,
            "metadata": metadata,
            "canonical_json": name::canonical_json(&metadata),
            "inner_digest": hex::encode(digest),
            "owner_key": hex::encode(owner),
            "name": name::derive(&owner, &digest),
        })
    });
    check(
        "name.json",
        &json!({
            "about": "name = SHA-256(\"gdp/name/1\" || owner_key || SHA-256(JCS(metadata))); owner_key is the public key of the P-256 private key 0x0101...01",
            "vectors": vectors,
        }),
    );
}

#[test]
fn vectors_of_segments() {
    let name = Name::from_bytes([0x11; 32]);
    let writer_name = Name::from_bytes([0x22; 32]);
    let (epoch_key, session) = ([0x33; 32], [0x44; 16]);
    let key = SigningKey::for_test(1);
    type Messages<'a> = &'a [(Encoding, &'a [u8])];
    let cases: [(&str, usize, Messages<'_>); 4] = [
        ("a message that shares one frame payload with its proof", 1400, &[(Encoding::Cdr, b"hello")]),
        ("an empty message", 1400, &[(Encoding::Bytes, b"")]),
        (
            "a message of three segments; the last shares a payload with the proof",
            200,
            &[(Encoding::Json, &[0x5a; 290])],
        ),
        (
            "a batch of three under one signature",
            1400,
            &[(Encoding::Ros1, b"one"), (Encoding::Ros1, b"two"), (Encoding::Ros1, b"three")],
        ),
    ];
    let vectors = cases.map(|(description, max_payload, messages)| {
        let epoch_key = EpochKey::from_bytes(epoch_key);
        let new_writer = |backend| Writer::with_session(name, writer_name, &epoch_key, &key, backend, session).unwrap();
        let mut segments = Segments::new();
        new_writer(Backend::RustCrypto)
            .seal_batch(1_700_000_000_123_456_789, messages, max_payload, &mut segments)
            .unwrap();
        for backend in Backend::ALL {
            let mut reader = Reader::new(name, &epoch_key, backend, Limits::default());
            reader.authorise(writer_name, key.verify_key()).unwrap();
            assert_eq!(tests::push_all(&mut reader, writer_name, segments.iter()).len(), messages.len());
        }
        json!({
            "description": description,
            "max_payload": max_payload,
            "first_sequence": 1,
            "timestamp_ns": "1700000000123456789",
            "messages": messages.iter().map(|(encoding, body)| json!({
                "encoding": u16::from(*encoding),
                "body": hex::encode(body),
            })).collect::<Vec<_>>(),
            "payloads": segments.iter().map(hex::encode).collect::<Vec<_>>(),
        })
    });
    check(
        "segment.json",
        &json!({
            "about": "sealed by a new session; the signing key is the P-256 private key 0x0101...01 with RFC 6979 nonces",
            "name": name,
            "writer": writer_name,
            "session": hex::encode(session),
            "epoch_key": hex::encode(epoch_key),
            "session_key": hex::encode(*Backend::default().hkdf_sha256(
                &session,
                &epoch_key,
                &[b"gdp/session/1", name.as_bytes(), writer_name.as_bytes()],
            ).unwrap()),
            "verify_key": key.verify_key(),
            "vectors": vectors,
        }),
    );
}

fn map(entries: &[(&str, &str)]) -> Metadata {
    entries.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect()
}
