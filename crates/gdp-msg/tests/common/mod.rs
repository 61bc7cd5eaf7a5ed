//! Schemas and messages for tests, in few words.
#![allow(dead_code, reason = "each test program uses some of it")]

use std::sync::Arc;

use gdp_msg::{Dialect, Encoding, Mapping, Options, Registry, Schema, TranscodeError, TypeName};

pub use Dialect::{Ros1, Ros2};

/// Of an embedded type.
pub fn embedded(dialect: Dialect, name: &str) -> Arc<Schema> {
    let name = TypeName::parse(name).expect("a name");
    Schema::resolve(&Registry::embedded(), dialect, &name).expect("an embedded type")
}

/// Of `test_msgs/Root`, with more definitions behind separators.
pub fn schema(dialect: Dialect, text: &str) -> Arc<Schema> {
    Schema::from_text(dialect, &TypeName::parse("test_msgs/Root").expect("a name"), text).expect("a definition")
}

pub fn mapping(from: &Schema, from_encoding: Encoding, to: &Schema, to_encoding: Encoding) -> Mapping {
    Mapping::new(from, from_encoding, to, to_encoding).unwrap_or_else(|error| panic!("{error}"))
}

/// What becomes of a message.
pub fn transcode(mapping: &Mapping, input: impl AsRef<[u8]>) -> Result<Vec<u8>, TranscodeError> {
    let mut output = b"of before".to_vec();
    let done = mapping.transcode(input.as_ref(), &mut output, &Options::default());
    assert!(done.is_ok() || output.is_empty(), "half a message");
    done.map(|()| output)
}

/// JSON into the binary encoding, and back to the same text.
pub fn json_round_trip(schema: &Schema, encoding: Encoding, json: &str) -> Vec<u8> {
    let bytes =
        transcode(&mapping(schema, Encoding::Json, schema, encoding), json).unwrap_or_else(|error| panic!("{error}"));
    let back =
        transcode(&mapping(schema, encoding, schema, Encoding::Json), &bytes).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(String::from_utf8(back).expect("text"), json);
    bytes
}
