//! Unit tests of `seal::wire`.

use super::*;
use crate::seal::heartbeat::HeartbeatBody;

const HEADER: SegmentHeader = SegmentHeader {
    kind: Kind::Body,
    sealed_len: 116,
    index: 2,
    sequence: 0x0102_0304_0506,
    cut: 0x0708,
    session: [7; 16],
    count: 4,
    size: 100,
    epoch: 0x090a_0b0c,
};

#[test]
fn headers_round_trip_and_other_versions_are_unknown() {
    for kind in [Kind::Body, Kind::Last, Kind::Bundle] {
        let header = SegmentHeader { kind, ..HEADER };
        assert_eq!(SegmentHeader::parse(&header.to_bytes()), Ok(header));
    }
    let heartbeat = SegmentHeader::heartbeat([7; 16], 1, 2, 3);
    assert_eq!(SegmentHeader::parse(&heartbeat.to_bytes()), Ok(heartbeat));
    let bytes = HEADER.to_bytes();
    assert_eq!(bytes[8..16], [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!(HEADER.nonce(), [1, 2, 3, 4, 5, 6, 7, 8, 0, 0, 0, 2]);
    for version in [0, 2, 4, 0x83] {
        let mut other = bytes;
        other[0] = version;
        assert_eq!(SegmentHeader::parse(&other), Err(DropReason::OtherVersion), "{version}");
    }
    // Kinds of later releases are refused, and flags are skipped.
    for kind in 4..16 {
        let mut other = bytes;
        other[1] = kind;
        assert_eq!(SegmentHeader::parse(&other), Err(DropReason::Unsupported), "{kind}");
    }
    for flags in 1..16 {
        let mut other = bytes;
        other[1] |= flags << 4;
        assert_eq!(SegmentHeader::parse(&other), Ok(HEADER), "{flags}");
    }
}

#[test]
fn only_headers_whose_fields_fit_each_other_have_a_length() {
    assert_eq!(HEADER.plaintext_len(), Some(100));
    // The segment before the last may be short.
    let before_last = SegmentHeader { index: 2, sealed_len: 17, ..HEADER };
    assert_eq!(before_last.plaintext_len(), Some(1));
    // The last one has the proof, and as much of the message as is left.
    let last = SegmentHeader { kind: Kind::Last, index: 3, sealed_len: 84, ..HEADER };
    for (sealed_len, len) in [(84, 68), (85, 69), (16 + 100 + 68 + 16 * 32, 100 + 68 + 16 * 32)] {
        assert_eq!(SegmentHeader { sealed_len, ..last }.plaintext_len(), Some(len));
    }
    let whole = SegmentHeader { index: 0, count: 1, sealed_len: 16 + 100 + 68 + 32, ..last };
    assert_eq!(whole.plaintext_len(), Some(200));
    let bundle = SegmentHeader { kind: Kind::Bundle, count: 9, ..whole };
    assert_eq!(bundle.plaintext_len(), Some(200));
    assert_eq!([last, whole, bundle].map(|header| header.is_whole()), [false, true, true]);
    assert_eq!([HEADER, last, whole, bundle].map(|header| header.messages()), [1, 1, 1, 9]);
    let heartbeat = SegmentHeader::heartbeat([7; 16], 1, 1, 0);
    assert_eq!(heartbeat.plaintext_len(), Some(80));
    for (what, header) in [
        ("short segment in the middle", SegmentHeader { index: 1, sealed_len: 115, ..HEADER }),
        ("long segment", SegmentHeader { sealed_len: 117, ..HEADER }),
        ("empty segment before the last", SegmentHeader { sealed_len: 16, ..HEADER }),
        ("no room for the tag", SegmentHeader { sealed_len: 15, ..HEADER }),
        ("a last segment without a proof", SegmentHeader { index: 3, ..HEADER }),
        ("index past the end", SegmentHeader { index: 4, ..HEADER }),
        ("a last segment before the end", SegmentHeader { index: 2, ..last }),
        ("a last segment past the end", SegmentHeader { index: 4, ..last }),
        ("a last segment without room for a proof", SegmentHeader { sealed_len: 83, ..last }),
        ("a last segment with too much", SegmentHeader { sealed_len: 16 + 101 + 68 + 16 * 32, ..last }),
        ("a whole message with a proof of another length", SegmentHeader { sealed_len: 217, ..whole }),
        ("a whole message without a proof", SegmentHeader { sealed_len: 116, ..whole }),
        ("a whole message behind the first segment", SegmentHeader { index: 1, ..whole }),
        ("a bundle with a proof of another length", SegmentHeader { sealed_len: 215, ..bundle }),
        ("a bundle of one message", SegmentHeader { count: 1, ..bundle }),
        ("a bundle of no messages", SegmentHeader { count: 0, ..bundle }),
        ("a bundle in several segments", SegmentHeader { index: 1, ..bundle }),
        ("a bundle past the last sequence", SegmentHeader { sequence: MAX_SEQUENCE - 7, ..bundle }),
        ("a bundle without room for its messages", SegmentHeader { count: 16, ..bundle }),
        ("a bundle of most messages", SegmentHeader { count: u32::MAX, ..bundle }),
        ("a bundle of nothing at sequence 0", SegmentHeader { sequence: 0, count: 0, ..bundle }),
        ("a bundle of nothing", SegmentHeader { size: 0, sealed_len: 84, ..bundle }),
        ("largest index", SegmentHeader { index: u32::MAX, count: u32::MAX, ..HEADER }),
        ("no segments", SegmentHeader { index: 0, count: 0, ..HEADER }),
        ("size 0", SegmentHeader { size: 0, sealed_len: 16, ..HEADER }),
        ("size over 16 bits", SegmentHeader { size: MAX_PLAINTEXT as u32 + 1, ..HEADER }),
        ("sequence 0", SegmentHeader { sequence: 0, ..HEADER }),
        ("the cut of heartbeats", SegmentHeader { cut: HEARTBEAT_CUT, ..HEADER }),
        ("a bundle with the cut of heartbeats", SegmentHeader { cut: HEARTBEAT_CUT, ..bundle }),
        ("a heartbeat with the cut of messages", SegmentHeader { cut: MAX_CUT, ..heartbeat }),
        ("a heartbeat with segments", SegmentHeader { count: 1, ..heartbeat }),
        ("a heartbeat with a size", SegmentHeader { size: 1, ..heartbeat }),
        ("heartbeat 0", SegmentHeader { index: 0, ..heartbeat }),
        ("a heartbeat of another length", SegmentHeader { sealed_len: 97, ..heartbeat }),
        ("a heartbeat before sequence 0", SegmentHeader { sequence: 0, ..heartbeat }),
    ] {
        assert_eq!(header.plaintext_len(), None, "{what}");
    }
}

#[test]
fn proofs_round_trip_and_are_bounded() {
    let (path, signature) = ([[3; 32], [4; 32]], [5; 64]);
    let proof = Proof { position: 3, path: &path, signature: &signature };
    let mut bytes = b"part".to_vec();
    bytes.resize(4 + proof_len(2), 0);
    proof.write(&mut bytes[4..]);
    assert_eq!(Proof::split(&bytes), Some((&b"part"[..], proof)));
    assert_eq!(Proof::split(&bytes[4..]), Some((&b""[..], proof)));
    // Position, depth and the reserved byte.
    let end = bytes.len() - 4;
    for (at, value) in [(1, 4), (0, 1), (2, 1), (2, 3), (2, 255), (3, 1)] {
        let mut other = bytes.clone();
        other[end + at] = value;
        assert_eq!(Proof::split(&other).filter(|(part, _)| *part == b"part"), None, "byte {at} = {value}");
    }
    assert!((0..proof_len(2)).all(|len| Proof::split(&bytes[bytes.len() - len..]).is_none()));
}

#[test]
fn heartbeats_round_trip_and_their_statement_binds_all_they_say() {
    let body = HeartbeatBody { timestamp_ns: 5, oldest: 6 };
    let bytes = body.to_bytes(&[7; 64]);
    assert_eq!(HeartbeatBody::parse(&bytes), Some((body, &[7; 64])));
    assert!((0..bytes.len()).all(|len| HeartbeatBody::parse(&bytes[..len]).is_none()));
    let (name, writer) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]));
    let header = SegmentHeader::heartbeat([7; 16], 1, 2, 3);
    let statement = body.statement(&name, &writer, &header);
    for (what, other) in [
        ("name", body.statement(&writer, &writer, &header)),
        ("writer", body.statement(&name, &name, &header)),
        ("session", body.statement(&name, &writer, &SegmentHeader { session: [8; 16], ..header })),
        ("number", body.statement(&name, &writer, &SegmentHeader { index: 2, ..header })),
        ("next", body.statement(&name, &writer, &SegmentHeader { sequence: 3, ..header })),
        ("timestamp", HeartbeatBody { timestamp_ns: 6, ..body }.statement(&name, &writer, &header)),
        ("oldest", HeartbeatBody { oldest: 7, ..body }.statement(&name, &writer, &header)),
    ] {
        assert_ne!(other, statement, "{what}");
    }
}
