//! Unit tests of `sdk::types`: the types in Rust have the bytes of their definitions.

use gdp_msg::{Encoding, Mapping, Options};
use serde_json::{Value, json};

use super::*;

#[test]
fn types_in_rust_have_the_bytes_of_the_definition() {
    let stamp = builtin_interfaces::Time { sec: 7, nanosec: 5 };
    same(
        &std_msgs::Header { stamp, frame_id: "map".into() },
        json!({"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "map"}),
    );
    same(&std_msgs::String { data: "hé".into() }, json!({"data": "hé"}));
    same(&std_msgs::Bool { data: true }, json!({"data": true}));
    let linear = geometry_msgs::Vector3 { x: 0.5, y: -1.0, z: 2.0 };
    same(
        &geometry_msgs::Twist { linear, angular: Default::default() },
        json!({"linear": {"x": 0.5, "y": -1.0, "z": 2.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}),
    );
}

#[test]
fn what_is_no_message_is_refused() {
    for bytes in [&b""[..], b"\0\x01\0\0", b"\0\x01\0\0\xff\xff\xff\xffabc", b"\0\x07\0\0\x01\0\0\0\0"] {
        from_cdr::<std_msgs::String>(bytes).unwrap_err();
    }
    assert_eq!(from_cdr::<std_msgs::Int32>(b"\0\0\0\0\0\0\0\x07").unwrap().data, 7, "big endian");
}

fn same<T: RosMessage + PartialEq + std::fmt::Debug>(message: &T, values: Value) {
    let (_, schema) = kind::<T>(&Types::load([]).unwrap()).unwrap();
    let bytes = to_cdr(message).unwrap();
    let mut cdr = Vec::new();
    let mapping = Mapping::within(&schema, Encoding::Json, Encoding::Cdr).unwrap();
    mapping.transcode(values.to_string().as_bytes(), &mut cdr, &Options::default()).unwrap();
    cdr.truncate(bytes.len());
    assert_eq!(bytes, cdr, "{}", T::TYPE);
    assert_eq!(&from_cdr::<T>(&bytes).unwrap(), message);
}
