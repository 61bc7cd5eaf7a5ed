//! Unit tests of `ros2::sample`.

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
fn the_encapsulation_survives_both_ways() {
    for (encoding, header) in [(RepresentationIdentifier::CDR_LE, 1), (RepresentationIdentifier::CDR_BE, 0)] {
        let sample = Decoder.decode_bytes(b"body", encoding).unwrap();
        assert_eq!(sample.bytes[..], [0, header, 0, 0, b'b', b'o', b'd', b'y']);
        assert_eq!(RawSample::parse(sample.bytes.clone()), Some(sample.clone()));
        assert_eq!(Encoder::<true>::to_bytes(&sample).unwrap(), "body");
    }
}
