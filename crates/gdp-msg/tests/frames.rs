//! Coordinate frames with a prefix, so that those of several robots are told apart.

mod common;

use common::{Ros1, Ros2, embedded, mapping, schema, transcode};
use gdp_msg::{Encoding, Fault, Mapping, Options, Schema};

const ENCODINGS: [Encoding; 4] = [Encoding::Cdr, Encoding::CdrBigEndian, Encoding::Ros1, Encoding::Json];

const TRANSFORM: &str =
    r#""transform":{"translation":{"x":1.0,"y":2.0,"z":3.0},"rotation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}}"#;
const POSE: &str =
    r#"{"pose":{"position":{"x":1.0,"y":2.0,"z":3.0},"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}},"covariance":C}"#;
const TWIST: &str =
    r#"{"twist":{"linear":{"x":1.0,"y":2.0,"z":3.0},"angular":{"x":0.0,"y":0.0,"z":0.0}},"covariance":C}"#;

/// In the messages, `~` stands for where the prefix is to be.
#[test]
fn frames_of_all_types_in_all_encodings_get_the_prefix_and_nothing_else_changes() {
    let transform =
        |from: &str, to: &str| format!(r#"{{"header":{},"child_frame_id":"{to}",{TRANSFORM}}}"#, header(from));
    let covariance = format!("[{}]", ["0.5"; 36].join(","));
    let [pose, twist] = [POSE, TWIST].map(|text| text.replace('C', &covariance));
    let field = r#"{"name":"x","offset":0,"datatype":7,"count":1}"#;
    for (kind, json) in [
        (
            "tf2_msgs/TFMessage",
            format!(r#"{{"transforms":[{},{}]}}"#, transform("~map", "~odom"), transform("~odom", "~base_link")),
        ),
        (
            "nav_msgs/Odometry",
            format!(r#"{{"header":{},"child_frame_id":"~base","pose":{pose},"twist":{twist}}}"#, header("~odom")),
        ),
        (
            "sensor_msgs/PointCloud2",
            format!(
                r#"{{"header":{},"height":1,"width":1,"fields":[{field}],"is_bigendian":false,"point_step":4,"row_step":4,"data":"AQIDBA==","is_dense":true}}"#,
                header("~laser")
            ),
        ),
        (
            "nav_msgs/Path",
            format!(
                r#"{{"header":{},"poses":[{{"header":{},"pose":P}},{{"header":{},"pose":P}}]}}"#,
                header("~map"),
                header("~a"),
                header("~b")
            )
            .replace('P', r#"{"position":{"x":1.0,"y":2.0,"z":3.0},"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}}"#),
        ),
        ("std_msgs/String", r#"{"data":"map"}"#.into()),
    ] {
        let schema = embedded(Ros2, kind);
        let (plain, prefixed) = (json.replace('~', ""), json.replace('~', "robot1/"));
        for from in ENCODINGS {
            let message = |json: &str| transcode(&mapping(&schema, Encoding::Json, &schema, from), json).unwrap();
            for to in ENCODINGS {
                let prefixing = prefixing(&schema, from, &schema, to);
                assert_eq!(prefixing.prefixes_frames(), kind != "std_msgs/String");
                let expected = transcode(&mapping(&schema, from, &schema, to), message(&prefixed)).unwrap();
                assert_eq!(transcode(&prefixing, message(&plain)).unwrap(), expected, "{kind}: {from} to {to}");
            }
        }
    }
}

#[test]
fn frames_of_ros_1_lose_their_slash_and_the_empty_one_stays_empty() {
    let (ros1, ros2) = (embedded(Ros1, "geometry_msgs/PointStamped"), embedded(Ros2, "geometry_msgs/PointStamped"));
    for (frame, expected) in [("/map", "robot1/map"), ("map", "robot1/map"), ("", ""), ("/", ""), ("a/b", "robot1/a/b")]
    {
        let json = format!(
            r#"{{"header":{{"seq":7,"stamp":{{"secs":1,"nsecs":2}},"frame_id":"{frame}"}},"point":{{"x":1,"y":2,"z":3}}}}"#
        );
        let message = transcode(&mapping(&ros1, Encoding::Json, &ros1, Encoding::Ros1), json).unwrap();
        let there = transcode(&prefixing(&ros1, Encoding::Ros1, &ros2, Encoding::Json), message).unwrap();
        let there: serde_json::Value = serde_json::from_slice(&there).unwrap();
        assert_eq!(there["header"]["frame_id"], expected);
    }
}

#[test]
fn only_headers_have_a_frame_id_and_a_child_may_be_anywhere() {
    let text = "string frame_id\nstring<=20 child_frame_id\nInner[] in\n===\nMSG: test_msgs/Inner\nstring \
                parent\nwstring child_frame_id\n";
    let schema = schema(Ros2, text);
    let json = |prefix: &str, long: &str| {
        format!(
            r#"{{"frame_id":"a","child_frame_id":"{prefix}{long}","in":[{{"parent":"c","child_frame_id":"{prefix}é"}}]}}"#
        )
    };
    let map = prefixing(&schema, Encoding::Json, &schema, Encoding::Json);
    assert_eq!(String::from_utf8(transcode(&map, json("", "b")).unwrap()).unwrap(), json("robot1/", "b"));
    let error = transcode(&map, json("", "twenty_characters_so")).unwrap_err();
    assert_eq!((error.path.as_str(), error.fault), ("child_frame_id", Fault::Bound(27, 20)));
}

#[test]
fn many_short_frames_grow_no_further_than_the_limit() {
    let schema = schema(Ros2, "Inner[] in\n===\nMSG: test_msgs/Inner\nstring child_frame_id\n");
    let mut message = vec![0, 1, 0, 0];
    message.extend(10_000_u32.to_le_bytes());
    (0..10_000).for_each(|_| message.extend(b"\x02\0\0\0a\0\0\0"));
    let prefix = "r".repeat(128);
    let map = Mapping::with_frame_prefix(&schema, Encoding::Cdr, &schema, Encoding::Cdr, &prefix).unwrap();
    let mut output = Vec::new();
    let limited = Options { max_output: 1 << 20, ..Options::default() };
    assert_eq!(map.transcode(&message, &mut output, &limited).unwrap_err().fault, Fault::Output(1 << 20));
    assert!(output.capacity() <= 2 << 20);
    map.transcode(&message, &mut output, &Options::default()).unwrap();
    for length in 0..64 {
        assert!(map.transcode(&message[..length], &mut output, &limited).is_err(), "{length} bytes");
    }
}

fn prefixing(from: &Schema, from_encoding: Encoding, to: &Schema, to_encoding: Encoding) -> Mapping {
    Mapping::with_frame_prefix(from, from_encoding, to, to_encoding, "robot1/").unwrap()
}

fn header(frame: &str) -> String {
    format!(r#"{{"stamp":{{"sec":1,"nanosec":2}},"frame_id":"{frame}"}}"#)
}
