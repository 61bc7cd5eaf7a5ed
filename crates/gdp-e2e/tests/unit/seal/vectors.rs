//! The published test vectors of names and segments. Their signatures follow RFC 6979, so the
//! vectors are the same in every run.

use super::refused::{self, Composition};
use super::wire::VERSION;
use super::*;
use crate::vectors::check;
use gdp_core::crypto::{self, Backend};
use gdp_core::identity::SigningKey;
use gdp_core::keys::EpochKey;
use gdp_core::name;
use gdp_core::name::{Metadata, Name};
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
    let owner = SigningKey::from_secret_bytes(&[1; 32]).unwrap().public();
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
            "about": "name = SHA-256(\"gdp/name/1\" || owner_key || SHA-256(JCS(metadata))); owner_key is the public \
             key of the P-256 private key 0x0101...01",
            "vectors": vectors,
        }),
    );
}

#[test]
fn vectors_of_segments() {
    let name = Name::from_bytes([0x11; 32]);
    let writer_name = Name::from_bytes([0x22; 32]);
    let (epoch_key, session) = ([0x33; 32], [0x44; 16]);
    let key = SigningKey::from_secret_bytes(&[1; 32]).unwrap();
    let (epoch, request) = (1_700_000_000, MessageId { session: [0x66; 16], sequence: 7 });
    let service = Name::from_bytes([0x77; 32]);
    let plain = |encoding, body| Draft::new(encoding, body);
    let cases: [(&str, usize, &[Draft<'_>]); 8] = [
        ("a message of one segment, which ends with its proof", 1400, &[plain(Encoding::Cdr, b"hello")]),
        ("an empty message", 1400, &[plain(Encoding::Bytes, b"")]),
        ("a message of three segments; the last one has the proof", 200, &[plain(Encoding::Json, &[0x5a; 290])]),
        (
            "a message whose end leaves no room for the proof: the last segment has nothing else",
            200,
            &[plain(Encoding::Json, &[0x5a; 228])],
        ),
        (
            "two messages under one signature, each in a segment",
            1400,
            &[plain(Encoding::Cdr, &[0x5a; 1000]), plain(Encoding::Cdr, &[0xa5; 1000])],
        ),
        (
            "a bundle of three messages",
            1400,
            &[plain(Encoding::Ros1, b"one"), plain(Encoding::Ros1, b"two"), plain(Encoding::Ros1, b"three")],
        ),
        (
            "a reply that says where it comes from",
            1400,
            &[Draft { in_reply_to: Some(request), origin: b"origin", ..plain(Encoding::Cdr, b"sum") }],
        ),
        ("a request to a service", 1400, &[Draft { service: Some(service), ..plain(Encoding::Cdr, b"summands") }]),
    ];
    let new_writer = || {
        let mut writer = Writer::with_session(name, writer_name, &key, Backend::RustCrypto, session).unwrap();
        writer.set_epoch(epoch, &EpochKey::from_bytes(epoch_key)).unwrap();
        writer
    };
    let new_reader = |backend| {
        let mut reader = Reader::new(name, backend, ReaderLimits::default());
        reader.authorise(writer_name, key.verify_key()).unwrap();
        reader.set_key(&writer_name, epoch, EpochKey::from_bytes(epoch_key)).unwrap();
        reader.confirm_session(&writer_name, session, 1).unwrap();
        reader
    };
    // Returns the output of readers with either back end.
    let read = |segments: &Segments| {
        let backends = Backend::ALL.iter().copied();
        let received = backends.map(|backend| {
            let mut reader = new_reader(backend);
            let mut received = Received::default();
            tests::push_into(&mut reader, writer_name, segments.iter(), &mut received);
            received
        });
        received.collect::<Vec<_>>()
    };
    let payloads = |segments: &Segments| segments.iter().map(hex::encode).collect::<Vec<_>>();
    let timestamp = 1_700_000_000_123_456_789;
    let mut segments = Segments::new();
    let vectors = cases.map(|(description, max_payload, messages)| {
        new_writer().seal_batch(timestamp, messages, max_payload, &mut segments).unwrap();
        assert!(read(&segments).iter().all(|received| received.messages.len() == messages.len()));
        json!({
            "description": description,
            "max_payload": max_payload,
            "first_sequence": 1,
            "timestamp_ns": timestamp.to_string(),
            "messages": messages.iter().map(|message| json!({
                "encoding": u16::from(message.encoding),
                "in_reply_to": message.in_reply_to.map(|request| json!({
                    "session": hex::encode(request.session),
                    "sequence": request.sequence,
                })),
                "origin": hex::encode(message.origin),
                "service": message.service.map(|service| service.to_string()),
                "body": hex::encode(message.body),
            })).collect::<Vec<_>>(),
            "payloads": payloads(&segments),
        })
    });

    let mut writer = new_writer();
    let hello = Draft::new(Encoding::Cdr, b"hello");
    writer.seal_batch(timestamp, &[hello], 1400, &mut segments).unwrap();
    writer.reseal(1, 1, timestamp, hello, MIN_PAYLOAD, &mut segments).unwrap();
    assert!(read(&segments).iter().all(|received| received.messages.len() == 1));
    let cut_anew = json!({
        "description": "the first message again, under cut 1 for the smallest payloads",
        "max_payload": MIN_PAYLOAD,
        "payloads": payloads(&segments),
    });
    writer.heartbeat(timestamp, u64::MAX, 1, &mut segments).unwrap();
    assert!(read(&segments).iter().all(|received| received.heartbeats.len() == 1));
    let heartbeat = json!({
        "description": "the first heartbeat, after one message, which can be had again",
        "number": 1,
        "next": 2,
        "oldest": 1,
        "timestamp_ns": timestamp.to_string(),
        "payloads": payloads(&segments),
    });
    let refused = refused::cases().into_iter().map(|(description, reason, payloads)| {
        for &backend in Backend::ALL {
            let mut reader = new_reader(backend);
            let mut push =
                |payload: &Vec<u8>| reader.push(Timestamps::default(), writer_name, payload, &mut Received::default());
            let results = payloads.iter().map(&mut push).collect::<Vec<_>>();
            let expected = (1..payloads.len()).map(|_| Ok(())).chain([Err(reason)]);
            assert_eq!(results, expected.collect::<Vec<_>>(), "{description}");
        }
        let payloads = payloads.iter().map(hex::encode).collect::<Vec<_>>();
        json!({ "description": description, "refused": reason.label(), "payloads": payloads })
    });
    let refused = refused.collect::<Vec<_>>();
    let later = later_releases().map(|(description, refused, payload)| {
        for &backend in Backend::ALL {
            let mut reader = new_reader(backend);
            let mut received = Received::default();
            let result = reader.push(Timestamps::default(), writer_name, &payload, &mut received);
            assert_eq!(result.err(), refused, "{description}");
            let bodies: Vec<_> = received.messages.iter().map(|message| &message.body[..]).collect();
            assert_eq!(bodies, refused.map_or(vec![&b"hello"[..]], |_| vec![]), "{description}");
        }
        json!({
            "description": description,
            "body": refused.map_or(Some(hex::encode(b"hello")), |_| None),
            "refused": refused.map(DropReason::label),
            "payload": hex::encode(payload),
        })
    });
    check(
        "segment.json",
        &json!({
            "about": "each vector is the begin of a session of its own. For these vectors alone all have the same \
             identifier and key; a writer never uses a session's sequence and cut for two messages. The signing key \
             is the P-256 private key 0x0101...01, with RFC 6979 nonces",
            "name": name,
            "writer": writer_name,
            "session": hex::encode(session),
            "epoch": epoch,
            "epoch_key": hex::encode(epoch_key),
            "session_key": hex::encode(*crypto::hkdf_sha256(
                &session,
                &epoch_key,
                &[b"gdp/session/1", name.as_bytes(), writer_name.as_bytes()],
            ).unwrap()),
            "commitment": hex::encode(*crypto::hkdf_sha256(
                &session,
                &epoch_key,
                &[b"gdp/commit/1", name.as_bytes(), writer_name.as_bytes()],
            ).unwrap()),
            "verify_key": key.verify_key(),
            "vectors": vectors,
            "cut_anew": cut_anew,
            "heartbeat": heartbeat,
            "later_releases": later,
            "refused": refused,
        }),
    );
}

/// Messages as later releases may send them, with the reason if this one refuses them.
fn later_releases() -> [(&'static str, Option<DropReason>, Vec<u8>); 6] {
    let skipped = [0x7f, 0xff, 0, 1, 9];
    let critical = [0x80, 1, 0, 1, 9];
    [
        ("an unknown flag", None, Composition { kind: 0x81, ..Default::default() }.payload()),
        (
            "an unknown extension that is not critical",
            None,
            Composition { extensions: &skipped, ..Default::default() }.payload(),
        ),
        (
            "an unknown extension that is critical",
            Some(DropReason::Unsupported),
            Composition { extensions: &critical, ..Default::default() }.payload(),
        ),
        (
            "an unknown kind of segments",
            Some(DropReason::Unsupported),
            Composition { kind: 4, ..Default::default() }.payload(),
        ),
        (
            "the next version",
            Some(DropReason::OtherVersion),
            Composition { version: VERSION + 1, ..Default::default() }.payload(),
        ),
        (
            "the version before",
            Some(DropReason::OtherVersion),
            Composition { version: VERSION - 1, ..Default::default() }.payload(),
        ),
    ]
}

fn map(entries: &[(&str, &str)]) -> Metadata {
    entries.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect()
}
