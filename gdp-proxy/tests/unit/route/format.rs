//! Unit tests of `route::format`.

use gdp_ros::roster::Dialect;
use gdp_wire::Name;

use super::*;
use crate::config::{Conversion, Direction, RuleOptions};
use crate::ros2::TopicName;

#[test]
fn what_goes_out_compressed_comes_in_as_it_was_whatever_is_said_there() {
    let (types, kind) = (Types::load([]).unwrap(), kind("std_msgs/msg/String"));
    let config = config(RuleOptions { compression: Some(Compression::Zstd), ..RuleOptions::default() });
    let mut out = Outbound::new(&config, &types, &kind, None).unwrap();
    let mut into = Inbound::new(&types, (kind.clone(), kind), (None, None), None).unwrap();
    for length in [10, 10_000] {
        let bytes = Bytes::from(
            [&[0, 1, 0, 0][..], &u32::to_le_bytes(length), &vec![b'x'; length as usize - 1], &[0]].concat(),
        );
        let body = out.convert(bytes.clone()).unwrap();
        let (encoding, carried) = out.pack(&body);
        assert_eq!(carried.len() < 100, encoding != seal::Encoding::Cdr || length == 10);
        assert_eq!(into.convert(&types, message(encoding, carried)).unwrap(), bytes);
    }
    let refusal = into.convert(&types, message(seal::Encoding::Other(0x8002), b"no frame")).unwrap_err();
    assert!(refusal.contains("compressed"), "{refusal}");
    let refusal = into.convert(&types, message(seal::Encoding::Other(0x8007), b"")).unwrap_err();
    assert!(refusal.contains("number 32775"), "{refusal}");
}

/// In JSON, compressed, to a ROS 1 graph: all that can be said of a topic at once.
#[test]
fn frames_have_the_prefix_of_either_side() {
    let (types, header) = (Types::load([]).unwrap(), kind("std_msgs/msg/Header"));
    let prefix = FramePrefix::try_from("r1/".to_owned()).unwrap();
    let cdr = Bytes::from_static(b"\0\x01\0\0\x01\0\0\0\x02\0\0\0\x05\0\0\0/map\0");
    let json = Some(Conversion::Json);
    let rule_options = RuleOptions { frame_prefix: Some(prefix.clone()), encoding: json, ..RuleOptions::default() };
    let mut out = Outbound::new(&config(rule_options), &types, &header, None).unwrap();
    let body = out.convert(cdr.clone()).unwrap();
    assert_eq!(body, &br#"{"stamp":{"sec":1,"nanosec":2},"frame_id":"r1/map"}"#[..]);

    let ros1 = Kind { dialect: Dialect::Ros1, name: "std_msgs/Header".into(), hash: vec![] };
    let mut into = Inbound::new(&types, (header, ros1), (None, None), Some(prefix)).unwrap();
    let native = into.convert(&types, message(seal::Encoding::Cdr, &cdr)).unwrap();
    assert_eq!(native[4..], b"\x01\0\0\0\x02\0\0\0\x06\0\0\0r1/map"[..], "behind its seq");
    let native = into.convert(&types, message(seal::Encoding::Json, &body)).unwrap();
    assert!(native.ends_with(b"r1/r1/map"), "who says it on both sides gets it twice");
}

#[test]
fn frames_of_a_type_that_nobody_knows_are_not_guessed() {
    let (types, own) = (Types::load([]).unwrap(), kind("my_robot/msg/Unheard"));
    let prefix = FramePrefix::try_from("r1/".to_owned()).unwrap();
    let config = config(RuleOptions { frame_prefix: Some(prefix.clone()), ..RuleOptions::default() });
    let refusals = [
        Outbound::new(&config, &types, &own, None).err(),
        Inbound::new(&types, (own.clone(), own.clone()), (None, None), Some(prefix.clone())).err(),
    ];
    for refusal in refusals.map(|refusal| refusal.unwrap().to_string()) {
        assert!(
            refusal.contains("a prefix in front of frames") && refusal.contains("my_robot/msg/Unheard"),
            "{refusal}"
        );
    }
    let text = "std_msgs/Header header\n===\nMSG: std_msgs/Header\nstring frame_id\n";
    assert!(Outbound::new(&config, &types, &own, Some(text)).is_ok());
    let told = (Some(text.into()), Some(text.into()));
    assert!(Inbound::new(&types, (own.clone(), own), told, Some(prefix)).is_ok());
}

fn kind(name: &str) -> Kind {
    Kind { dialect: Dialect::Ros2, name: name.into(), hash: vec![] }
}

fn config(rule_options: RuleOptions) -> TopicConfig {
    rule_options.topic(&TopicName::parse("/a").unwrap(), "here", None, Direction::Out)
}

fn message(encoding: seal::Encoding, body: &[u8]) -> Message {
    let name = Name::from_bytes([1; 32]);
    Message {
        name,
        writer: name,
        session: [0; 16],
        sequence: 1,
        timestamp_ns: 0,
        encoding,
        in_reply_to: None,
        origin: Bytes::new(),
        latched: None,
        service: None,
        body: Bytes::copy_from_slice(body),
    }
}
