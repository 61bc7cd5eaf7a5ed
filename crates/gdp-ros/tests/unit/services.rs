//! Unit tests of `services`.

use bytes::Bytes;

use super::*;

fn described(dialect: Dialect, name: &str) -> Description {
    Types::load([]).unwrap().describe_service(Kind { dialect, name: name.into(), hash: vec![] })
}

#[test]
fn a_client_of_one_ros_version_calls_a_server_of_the_other() {
    let types = Types::load([]).unwrap();
    let server = described(Dialect::Ros1, "std_srvs/SetBool");
    assert_eq!(hex::encode(&server.kind.hash), "09fb03525b03e7ea1fd3992bafd87e16");
    let client = types.service_counterpart(&server, Dialect::Ros2).unwrap();
    assert_eq!((client.kind.name.as_str(), client.kind.hash.len()), ("std_srvs/srv/SetBool", 32));
    let mut both = types.service_converters(&client, &server).unwrap();
    let request = both.request.convert(Bytes::from_static(b"\0\x01\0\0\x01")).unwrap();
    assert_eq!(&request[..], b"\x01");
    let response = both.response.convert(Bytes::from_static(b"\x01\x02\0\0\0on")).unwrap();
    assert_eq!(&response[..], b"\0\x01\0\0\x01\0\0\0\x03\0\0\0on\0");
    // The other way around the names and sums are those that ROS 1 has.
    let back = types.service_counterpart(&client, Dialect::Ros1).unwrap();
    assert_eq!(back.kind, server.kind);
}

#[test]
fn a_type_that_only_the_server_knows_is_made_from_its_definitions() {
    let types = Types::load([]).unwrap();
    let definitions = Definitions { request: "int64 a\nint64 b\n".into(), response: "int64 sum\n".into() };
    let kind = Kind { dialect: Dialect::Ros2, name: "my_robot/srv/AddTwoInts".into(), hash: vec![] };
    let server = Description { kind, node: "/robot7/driver".into(), definitions: Some(definitions) };
    let client = types.service_counterpart(&server, Dialect::Ros1).unwrap();
    assert_eq!(client.kind.name, "my_robot/AddTwoInts");
    // As genpy computes it of rospy_tutorials/AddTwoInts.
    assert_eq!(hex::encode(&client.kind.hash), "6a2e34150c00229791cc89ff309fff21");
    let mut both = types.service_converters(&client, &server).unwrap();
    let request = [1u64.to_le_bytes(), 2u64.to_le_bytes()].concat();
    assert_eq!(both.request.convert(request.clone().into()).unwrap(), [&[0, 1, 0, 0][..], &request].concat());
    let unknown = Description { definitions: None, ..server };
    let refusal = types.service_counterpart(&unknown, Dialect::Ros1).unwrap_err().to_string();
    assert!(refusal.contains("my_robot/srv/AddTwoInts_Request"), "{refusal}");
}

#[test]
fn what_is_of_one_dialect_needs_no_definition() {
    let kind = Kind { dialect: Dialect::Ros2, name: "my_robot/srv/Unheard".into(), hash: vec![] };
    let types = Types::load([]).unwrap();
    let server = types.describe_service(kind);
    assert_eq!((server.definitions.is_none(), server.kind.hash.len()), (true, 0));
    let client = types.service_counterpart(&server, Dialect::Ros2).unwrap();
    let both = types.service_converters(&client, &server).unwrap();
    assert!(matches!((both.request, both.response), (Converter::None, Converter::None)));
}
