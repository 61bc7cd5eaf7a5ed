//! Unit tests of `types`.

use super::*;

fn kind(dialect: Dialect, name: &str) -> Kind {
    Kind { dialect, name: name.into(), hash: vec![] }
}

#[test]
fn what_one_ros_version_says_the_other_understands() {
    let types = Types::load([]).unwrap();
    let ros1 = kind(Dialect::Ros1, "std_msgs/String");
    let from = Form { kind: &ros1, definition: Some("string data\n"), encoding: Encoding::Ros1 };
    let (ros2, definition) = types.counterpart(&from, Dialect::Ros2).unwrap();
    assert_eq!(ros2.name, "std_msgs/msg/String");
    let to = Form { kind: &ros2, definition: definition.as_deref(), encoding: Encoding::Cdr };
    let mut there = types.converter(&from, &to).unwrap();
    let mut back = types.converter(&to, &from).unwrap();
    let message = Bytes::from_static(b"\x02\0\0\0hi");
    let cdr = there.convert(message.clone()).unwrap();
    assert_eq!(&cdr[..], b"\0\x01\0\0\x03\0\0\0hi\0");
    assert_eq!(back.convert(cdr).unwrap(), message);
    assert!(there.convert(Bytes::from_static(b"\xff\0\0\0hi")).is_err());

    let own = kind(Dialect::Ros1, "my_robot/Unheard");
    let from = Form { kind: &own, definition: Some("time stamp\n"), encoding: Encoding::Ros1 };
    let (kind, definition) = types.counterpart(&from, Dialect::Ros2).unwrap();
    assert_eq!(kind.name, "my_robot/msg/Unheard");
    assert!(definition.unwrap().starts_with("builtin_interfaces/Time stamp\n"));
}

#[test]
fn frames_get_a_prefix_where_the_type_has_some_and_is_known() {
    let types = Types::load([]).unwrap();
    let form = |kind, definition| Form { kind, definition, encoding: Encoding::Cdr };
    let header = kind(Dialect::Ros2, "std_msgs/msg/Header");
    let header = form(&header, None);
    let mut converter = types.prefixing_converter(&header, &header, "r1/").unwrap();
    let message = Bytes::from_static(b"\0\x01\0\0\x01\0\0\0\x02\0\0\0\x04\0\0\0map\0");
    let expected = b"\0\x01\0\0\x01\0\0\0\x02\0\0\0\x07\0\0\0r1/map\0";
    assert_eq!(&converter.convert(message).unwrap()[..], expected);

    let string = kind(Dialect::Ros2, "std_msgs/msg/String");
    let string = form(&string, None);
    assert!(matches!(types.prefixing_converter(&string, &string, "r1/"), Ok(Converter::None)), "as fast as before");
    let own = kind(Dialect::Ros2, "my_robot/msg/Unheard");
    let refusal = types.prefixing_converter(&form(&own, None), &form(&own, None), "r1/").err().unwrap().to_string();
    assert!(refusal.contains("must know the type") && refusal.contains("my_robot/msg/Unheard"), "{refusal}");
    let defined = form(&own, Some("string child_frame_id\n"));
    assert!(matches!(types.prefixing_converter(&defined, &defined, "r1/"), Ok(Converter::Some { .. })));
}

#[test]
fn what_is_the_same_needs_no_definition() {
    let own = kind(Dialect::Ros2, "my_robot/msg/Unheard");
    let form = Form { kind: &own, definition: None, encoding: Encoding::Cdr };
    assert!(matches!(Types::load([]).unwrap().converter(&form, &form), Ok(Converter::None)));
    let json = Form { encoding: Encoding::Json, ..form.clone() };
    let refusal = Types::load([]).unwrap().converter(&form, &json).err().unwrap().to_string();
    assert!(refusal.contains("my_robot/msg/Unheard"), "{refusal}");
    let defined = Form { definition: Some("int32 a\nstring b\n"), ..form };
    let json = Form { encoding: Encoding::Json, ..defined.clone() };
    let mut converter = Types::load([]).unwrap().converter(&json, &defined).unwrap();
    let cdr = converter.convert(Bytes::from_static(br#"{"a":7,"b":"x"}"#)).unwrap();
    assert_eq!(&cdr[..], b"\0\x01\0\0\x07\0\0\0\x02\0\0\0x\0");
}
