//! Unit tests of `ros2::names`.

use super::*;

#[test]
fn topics_and_types_are_mangled_as_every_ros_2_does() {
    let topic = TopicName::parse("/robot1/image_raw").unwrap();
    assert_eq!(topic.to_dds(), "rt/robot1/image_raw");
    let kind = TypeName::parse("std_msgs/msg/String").unwrap();
    assert_eq!(kind.to_dds(), "std_msgs::msg::dds_::String_");
    assert_eq!(TypeName::from_dds(&kind.to_dds()), Ok(kind));
    let feedback = TypeName::from_dds("example_interfaces::action::dds_::Fibonacci_FeedbackMessage_").unwrap();
    assert_eq!(feedback.as_str(), "example_interfaces/action/Fibonacci_FeedbackMessage");
}

#[test]
fn what_is_not_a_topic_name_is_refused() {
    let long = format!("/{}", "a".repeat(MAX_TOPIC));
    for text in ["", "/", "chatter", "/a//b", "/a/", "/1a", "/a b", "/a\n", "/é", "rt/chatter", "~/x", &long] {
        assert!(TopicName::parse(text).is_err(), "{text:?}");
    }
}

#[test]
fn what_is_not_a_type_name_is_refused() {
    for text in ["", "String", "std_msgs/String", "std_msgs/msg/String/x", "std_msgs/foo/String", "std_msgs/msg/"] {
        assert!(TypeName::parse(text).is_err(), "{text:?}");
    }
    for dds in ["std_msgs::msg::String", "std_msgs::msg::dds_::String", "HelloWorld", "a::msg::dds_::_x::y_", "::::::"]
    {
        assert!(TypeName::from_dds(dds).is_err(), "{dds:?}");
    }
}

#[test]
fn a_refusal_names_the_text_and_the_remedy() {
    let refusal = TypeName::parse("std_msgs/String").unwrap_err().to_string();
    assert!(refusal.contains("std_msgs/String") && refusal.contains("package/msg/Name"), "{refusal}");
    assert!(!TopicName::parse("\u{1b}[2J").unwrap_err().to_string().contains('\u{1b}'));
}
