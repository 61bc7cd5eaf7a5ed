//! Tests of [`super`].

use super::*;

const STRING: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

#[test]
fn a_key_has_domain_name_type_and_hash() {
    let hash = TypeHash::parse(STRING).unwrap();
    let kind = "std_msgs::msg::dds_::String_";
    assert_eq!(topic_key(0, "/chatter", kind, &hash), format!("0/chatter/{kind}/{STRING}"));
    assert_eq!(topic_key(7, "/robot/chatter", kind, &hash), format!("7/robot/chatter/{kind}/{STRING}"));
}

#[test]
fn other_texts_are_no_hash() {
    for text in ["", "TypeHashNotSupported", "RIHS01_", "RIHS02_df66", &STRING[..70], &STRING.replace('d', "D")] {
        assert_eq!(TypeHash::parse(text), None, "{text}");
    }
}
