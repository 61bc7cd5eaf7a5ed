//! Unit tests of `ros2::discovery`.

use super::*;

#[test]
fn a_type_is_expected_as_long_as_an_endpoint_is_there() {
    let (discovery, string) = (Discovery::default(), TypeName::parse("std_msgs/msg/String").unwrap());
    let topics = || {
        let expected = discovery.expected.lock();
        expected.iter().filter(|(_, kind)| kind.strong_count() > 0).count()
    };
    let [reader, writer] = [0, 1].map(|_| discovery.expect("rt/a", &string));
    drop(writer);
    assert_eq!((&*reader, topics()), ("std_msgs::msg::dds_::String_", 1), "the other one is there still");
    drop(reader);
    (0..100).for_each(|i| drop(discovery.expect(&format!("rt/{i}"), &string)));
    let other = discovery.expect("rt/a", &TypeName::parse("std_msgs/msg/Int32").unwrap());
    assert_eq!((&*other, discovery.expected.lock().len()), ("std_msgs::msg::dds_::Int32_", 1));
}
