//! Unit tests of `ros2::raw`.

use super::*;

#[test]
fn only_what_dds_could_write_is_taken_from_the_fabric() {
    let parse = |bytes: &'static [u8]| RawSample::parse(Bytes::from_static(bytes)).map(|s| s.representation);
    assert_eq!(parse(&[0, 1, 0, 0, 1, 2, 3, 4]), Some(Representation::CdrLe));
    assert_eq!(parse(&[0, 0, 0, 3]), Some(Representation::CdrBe));
    for bytes in [&[][..], &[0, 1, 0], &[0, 7, 0, 0, 1], &[0, 3, 0, 0], &[1, 1, 0, 0]] {
        assert_eq!(parse(bytes), None, "{bytes:?}");
    }
}

#[test]
fn a_gap_counts_once_and_late_messages_count_nothing() {
    let mut gaps = Gaps::default();
    let writer = GUID::from_bytes([1; 16]);
    let before = [7, 8, 11, 9, 12].map(|sequence| gaps.before(writer, SequenceNumber::new(sequence)));
    assert_eq!(before, [0, 0, 2, 0, 0]);
    assert_eq!(gaps.before(GUID::from_bytes([2; 16]), SequenceNumber::new(100)), 0, "a writer heard from now on");
    assert_eq!(gaps.before(writer, SequenceNumber::new(i64::MIN)), 0);
}

#[test]
fn the_encapsulation_survives_both_ways() {
    for (encoding, header) in [(RepresentationIdentifier::CDR_LE, 1), (RepresentationIdentifier::CDR_BE, 0)] {
        let sample = Decoder.decode_bytes(b"body", encoding).unwrap();
        assert_eq!(sample.bytes[..], [0, header, 0, 0, b'b', b'o', b'd', b'y']);
        assert_eq!(RawSample::parse(sample.bytes.clone()), Some(sample.clone()));
        assert_eq!(Encoder::<true>::to_bytes(&sample).unwrap(), "body");
    }
}

#[test]
fn source_timestamps_keep_their_value() {
    let ns = 1_700_000_000_123_456_789;
    let back = nanoseconds(timestamp(ns));
    assert!(ns - back <= 1, "{back}");
    assert!(timestamp(u64::MAX) < Timestamp::INFINITE, "a time after 2106 is not passed on");
}
