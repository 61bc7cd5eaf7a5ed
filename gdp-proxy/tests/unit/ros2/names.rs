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
fn what_is_not_a_dds_type_name_of_ros_is_refused() {
    for dds in ["std_msgs::msg::String", "std_msgs::msg::dds_::String", "HelloWorld", "a::msg::dds_::_x::y_", "::::::"]
    {
        assert!(TypeName::from_dds(dds).is_err(), "{dds:?}");
    }
}
