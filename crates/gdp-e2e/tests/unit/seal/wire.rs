//! Unit tests of `seal::wire`.

use super::*;

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
    for header in [HEADER, SegmentHeader { kind: Kind::Proof, ..HEADER }, SegmentHeader::heartbeat([7; 16], 1, 2, 3)] {
        assert_eq!(SegmentHeader::parse(&header.to_bytes()), Some(header));
    }
    let bytes = HEADER.to_bytes();
    assert_eq!(bytes[8..16], [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!(HEADER.nonce(), [1, 2, 3, 4, 5, 6, 7, 8, 0, 0, 0, 2]);
    for (at, value) in [(0, 0), (0, 2), (0, 4), (1, 3), (1, 4), (1, 0x81)] {
        let mut other = bytes;
        other[at] = value;
        assert_eq!(SegmentHeader::parse(&other), None, "byte {at} = {value}");
    }
}

#[test]
fn only_headers_whose_fields_fit_each_other_have_a_length() {
    assert_eq!(HEADER.plaintext_len(), Some(100));
    assert_eq!(SegmentHeader { index: 3, sealed_len: 17, ..HEADER }.plaintext_len(), Some(1));
    let proof = SegmentHeader { kind: Kind::Proof, index: 4, sealed_len: 84, ..HEADER };
    assert_eq!(proof.plaintext_len(), Some(68));
    let heartbeat = SegmentHeader::heartbeat([7; 16], 1, 1, 0);
    assert_eq!(heartbeat.plaintext_len(), Some(80));
    for (what, header) in [
        ("short segment in the middle", SegmentHeader { sealed_len: 115, ..HEADER }),
        ("long segment", SegmentHeader { index: 3, sealed_len: 117, ..HEADER }),
        ("empty last segment", SegmentHeader { index: 3, sealed_len: 16, ..HEADER }),
        ("no room for the tag", SegmentHeader { sealed_len: 15, ..HEADER }),
        ("index past the end", SegmentHeader { index: 4, ..HEADER }),
        ("largest index", SegmentHeader { index: u32::MAX, count: u32::MAX, ..HEADER }),
        ("no segments", SegmentHeader { index: 0, count: 0, ..HEADER }),
        ("size 0", SegmentHeader { size: 0, sealed_len: 16, ..HEADER }),
        ("size over 16 bits", SegmentHeader { index: 3, size: MAX_PLAINTEXT as u32 + 1, ..HEADER }),
        ("sequence 0", SegmentHeader { sequence: 0, ..HEADER }),
        ("the cut of heartbeats", SegmentHeader { cut: HEARTBEAT_CUT, ..HEADER }),
        ("a proof with the cut of heartbeats", SegmentHeader { cut: HEARTBEAT_CUT, ..proof }),
        ("a heartbeat with the cut of messages", SegmentHeader { cut: MAX_CUT, ..heartbeat }),
        ("a heartbeat with segments", SegmentHeader { count: 1, ..heartbeat }),
        ("a heartbeat with a size", SegmentHeader { size: 1, ..heartbeat }),
        ("heartbeat 0", SegmentHeader { index: 0, ..heartbeat }),
        ("a heartbeat of another length", SegmentHeader { sealed_len: 97, ..heartbeat }),
        ("a heartbeat before sequence 0", SegmentHeader { sequence: 0, ..heartbeat }),
        ("proof before the end", SegmentHeader { index: 3, ..proof }),
        ("proof of another length", SegmentHeader { sealed_len: 85, ..proof }),
        ("proof with too long a path", SegmentHeader { sealed_len: 84 + 17 * 32, ..proof }),
    ] {
        assert_eq!(header.plaintext_len(), None, "{what}");
    }
}

#[test]
fn proofs_round_trip_and_are_bounded() {
    let (path, signature) = ([[3; 32], [4; 32]], [5; 64]);
    let proof = Proof { position: 3, path: &path, signature: &signature };
    let mut bytes = vec![0; proof_len(2)];
    proof.write(&mut bytes);
    assert_eq!(Proof::parse(&bytes), Some(proof));
    for (at, value) in [(1, 4), (0, 1), (2, 1), (2, 3), (2, 255), (3, 1)] {
        let mut other = bytes.clone();
        other[at] = value;
        assert_eq!(Proof::parse(&other), None, "byte {at} = {value}");
    }
    assert!((0..bytes.len()).all(|len| Proof::parse(&bytes[..len]).is_none()));
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
