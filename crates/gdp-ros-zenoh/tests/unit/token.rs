//! Tests of [`super`].

use super::*;

const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

#[test]
fn tokens_are_read_and_written() {
    let node = "@ros2_lv/0/5b00d52e2e8d4f2ab9d5b2a0a4a1f3c1/0/0/NN/%/%/talker";
    let token = Token::parse(node).unwrap();
    assert_eq!((token.full_node().as_str(), token.role, token.domain), ("/talker", Role::Node, 0));
    assert_eq!(token.to_string(), node);

    let kind = "std_msgs::msg::dds_::String_";
    let publisher = format!(
        "@ros2_lv/2/5b00d52e2e8d4f2ab9d5b2a0a4a1f3c1/1/11/MP/%/%robot/driver/%a%chatter/{kind}/{HASH}/::,7:,:,:,,"
    );
    let token = Token::parse(&publisher).unwrap();
    assert_eq!(token.to_string(), publisher);
    assert_eq!(token.full_node(), "/robot/driver");
    let endpoint = token.endpoint.as_ref().unwrap();
    assert_eq!((endpoint.name.as_str(), endpoint.kind.as_str()), ("/a/chatter", kind));
    assert_eq!((endpoint.hash, endpoint.qos.depth), (TypeHash::parse(HASH), Some(7)));
    assert_eq!(token.gid(), gid(&publisher));
}

#[test]
fn a_type_without_a_hash_is_read() {
    let token = "@ros2_lv/0/ab/0/1/SS/%/%/n/%s/a::srv::dds_::B_/TypeHashNotSupported/::,10:,:,:,,";
    let parsed = Token::parse(token).unwrap();
    assert_eq!(parsed.endpoint.as_ref().unwrap().hash, None);
    assert_eq!(parsed.to_string(), token);
}

/// The reference value of XXH3-128 for no input is 99aa06d3014798d86001c324468d497f.
#[test]
fn a_gid_is_little_endian() {
    let bytes = [0x7f, 0x49, 0x8d, 0x46, 0x24, 0xc3, 0x01, 0x60, 0xd8, 0x98, 0x47, 0x01, 0xd3, 0x06, 0xaa, 0x99];
    assert_eq!(gid(""), bytes);
}

#[test]
fn broken_tokens_are_refused() {
    let good = format!("@ros2_lv/0/ab/0/1/MP/%/%/n/%t/a::msg::dds_::B_/{HASH}/::,10:,:,:,,");
    assert!(Token::parse(&good).is_some());
    for end in 0..good.len() - 4 {
        let part = &good[..end];
        assert!(Token::parse(part).is_none(), "{part}");
    }
    let long = good.replace("%t", &"t".repeat(MAX_LENGTH));
    let broken = [
        good.replace("@ros2_lv", "ros2_lv"),
        good.replace("/0/ab", "/-1/ab"),
        good.replace("/ab/", "/zz/"),
        good.replace("/MP/", "/XX/"),
        good.replace("/n/", "/*/"),
        good.replace("%t", "t\u{e9}"),
        good.replace("::msg", "**msg"),
        good.clone() + "/more",
        good.replace("/MP/", "/NN/"),
        long,
    ];
    for text in broken {
        assert!(Token::parse(&text).is_none(), "{text}");
    }
}
