//! Unit tests of `cbor`.

use super::*;
use serde::Deserialize;

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sample {
    zebra: u64,
    a: u8,
    #[serde(with = "array")]
    mid: [u8; 3],
}

const SAMPLE: Sample = Sample { zebra: 500, a: 1, mid: [1, 2, 3] };

#[test]
fn keys_are_in_bytewise_order_of_their_encoding() {
    // {"a": 1, "mid": h'010203', "zebra": 500}: shorter keys first, because their heads are
    // smaller.
    let expected = hex::decode("a3616101636d696443010203657a656272611901f4").unwrap();
    assert_eq!(encode(&SAMPLE).unwrap(), expected);
    assert_eq!(decode::<Sample>(&expected, 64), Ok(SAMPLE));
}

#[test]
fn other_encodings_of_the_same_value_are_refused() {
    for (what, hex) in [
        ("key order", "a3657a656272611901f4616101636d696443010203"),
        ("long integer", "a361611801636d696443010203657a656272611901f4"),
        ("indefinite map", "bf616101636d696443010203657a656272611901f4ff"),
        ("trailing byte", "a3616101636d696443010203657a656272611901f400"),
        ("duplicate key", "a4616101616101636d696443010203657a656272611901f4"),
        ("unknown field", "a46161016162016 3 6d696443010203657a656272611901f4"),
        ("truncated", "a3616101636d696443010203657a65627261"),
    ] {
        let bytes = hex::decode(hex.replace(' ', "")).unwrap();
        assert!(decode::<Sample>(&bytes, 64).is_err(), "{what}");
    }
    assert_eq!(decode::<Sample>(&encode(&SAMPLE).unwrap(), 5), Err(CborError::TooLong { got: 21, max: 5 }));
}

#[test]
fn an_error_is_in_words() {
    let reason = |bytes: &[u8]| decode::<Vec<u8>>(bytes, 100).unwrap_err().to_string();
    for (bytes, expected) in [(&[][..], "too early"), (b"\xfe", "byte 0"), (b"\x61a", "expected"), (&[0x81; 99], "")] {
        let error = reason(bytes);
        assert!(error.contains(expected) && !error.contains('('), "{error}");
    }
}

#[test]
fn people_read_hex() {
    assert_eq!(serde_json::to_string(&SAMPLE).unwrap(), r#"{"zebra":500,"a":1,"mid":"010203"}"#);
    assert_eq!(serde_json::from_str::<Sample>(r#"{"zebra":500,"a":1,"mid":"010203"}"#).unwrap(), SAMPLE);
}
