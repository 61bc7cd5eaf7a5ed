//! Unit tests of `name`.

use super::*;

#[test]
fn one_name_in_four_spellings() {
    let name = TypeName::parse("std_msgs/String").unwrap();
    assert_eq!(TypeName::parse("std_msgs/msg/String").unwrap(), name);
    assert_eq!(TypeName::parse("std_msgs::msg::dds_::String_").unwrap(), name);
    assert_eq!((name.to_string(), name.dds()), ("std_msgs/msg/String".into(), "std_msgs::msg::dds_::String_".into()));
    assert_eq!(name.display(Dialect::Ros1), "std_msgs/String");
    let half = TypeName::parse("std_srvs::srv::dds_::SetBool_Request_").unwrap();
    assert_eq!(half, TypeName::parse("std_srvs/srv/SetBool_Request").unwrap());
    assert_eq!(half, TypeName::parse("std_srvs/SetBool").unwrap().service_halves()[0]);
    assert_eq!(half.display(Dialect::Ros1), "std_srvs/SetBoolRequest");
}

#[test]
fn what_names_no_type() {
    for text in
        ["", "String", "a//b", "a/b/c", "a/msg/b/c", "a/../b", "1a/B", "a/ B", "a::msg::B_", "a::msg::dds_::B", "ä/B"]
    {
        assert!(TypeName::parse(text).is_err(), "{text}");
    }
    assert!(TypeName::parse(&format!("a/{}", "b".repeat(256))).is_err());
}
