//! Round trips of messages: encoded and printed as in ROS 2, and entered by users.

use std::sync::Arc;

use gdp_msg::{Base, Dialect, Encoding, Mapping, Options, Registry, Schema, TypeName};
use serde::Deserialize;
use serde_json::Value;

use super::fill::{FillError, fill};
use super::python;
use super::user_input::UserInput;
use super::view::{Limits, View, ViewError};
use super::yaml::document;

const ALL: Limits = Limits { length: 128, no_arrays: false, no_texts: false };

/// See `ros/oracle/generate.py`.
#[derive(Deserialize)]
struct Case {
    r#type: String,
    cdr: String,
    yaml: String,
    no_arr: String,
    no_str: String,
    repr: String,
}

#[test]
fn messages_are_printed_as_ros_2_prints_them() {
    let cases: Vec<Case> = serde_json::from_str(include_str!("ros/oracle/messages.json")).unwrap();
    for Case { r#type, cdr, yaml, no_arr, no_str, repr } in cases {
        let (schema, root) = known(&r#type);
        let json = decode(&schema, &hex::decode(cdr).unwrap());
        let view = View::of(&schema, &root, &json);
        for (limits, expected) in [
            (ALL, yaml),
            (Limits { no_arrays: true, ..ALL }, no_arr),
            (Limits { length: 3, no_texts: true, ..ALL }, no_str),
        ] {
            let printed = document(&view.item(&limits).unwrap()).unwrap();
            let read = |text: &str| format!("{:?}", UserInput::parse(text).unwrap());
            assert_eq!(read(&printed), read(&expected), "{}: {printed}", r#type);
        }
        // numpy breaks lines and omits zeros.
        if !repr.contains("array(") {
            assert_eq!(python::value(&view).unwrap(), repr, "{}", r#type);
        }
    }
}

#[test]
fn fields_are_found_by_their_path() {
    let (schema, root) = known("geometry_msgs/PoseStamped");
    let json = fill(&schema, &UserInput::parse("{pose: {position: {x: 1.5}}}").unwrap(), (0, 0)).unwrap();
    let view = View::of(&schema, &root, &json);
    let path = |text: &str| text.split('.').map(str::to_owned).collect::<Vec<_>>();
    let x = view.at(&path("pose.position.x")).unwrap();
    assert_eq!((python::value(&x).unwrap(), x.is_message()), ("1.5".into(), false));
    assert!(view.at(&path("pose.position")).unwrap().is_message());
    let Err(ViewError::Field { there, .. }) = view.at(&path("pose.place")) else { panic!("there is none") };
    assert_eq!(there, ["position", "orientation"]);
    assert!(matches!(view.at(&path("header.frame_id.x")), Err(ViewError::NoMessage("string", _))));
}

#[test]
fn what_is_not_given_is_as_the_definition_says() {
    let name = TypeName::parse("my_robot/Task").unwrap();
    let text = "string label \"it's\"\nint32[] steps [1, 2]\nfloat64[3] at\nbool is_on true\nuint8 LEVEL=3\nbyte[] \
                raw\nPart part\n\
        ================================================================================\nMSG: my_robot/Part\nint64 count -5\n";
    let schema = Schema::from_text(Dialect::Ros2, &name, text).unwrap();
    let message = |given: &str| fill(&schema, &UserInput::parse(given).unwrap(), (0, 0));
    let all = message("{}").unwrap();
    let expected = serde_json::json!({
        "label": "it's", "steps": [1, 2], "at": [0, 0, 0], "is_on": true, "raw": [], "part": {"count": -5},
    });
    assert_eq!(all, expected);
    let some = message("{label: 7, at: [1, .nan, -.inf], raw: [A, 2], part: {count: 9223372036854775807}}").unwrap();
    assert_eq!((&some["label"], &some["at"]), (&"7".into(), &serde_json::json!([1.0, "NaN", "-Infinity"])));
    encode(&schema, &some);
    for (given, needle) in [
        ("{lable: x}", "no field `lable`; its fields are: label, steps"),
        ("{part: {counts: 1}}", "no field `part.counts`"),
        ("{part: 7}", "`part`: a mapping with fields of my_robot/msg/Part is expected, and an integer is given"),
        ("{at: [1]}", "`at`: 3 elements, and 1 are given"),
        ("{steps: 1}", "`steps`: a list"),
        ("{is_on: 1}", "`is_on`: true or false"),
        ("{label: [x]}", "`label`: a text"),
        ("[1]", "`the message`: a mapping"),
    ] {
        let refusal = message(given).unwrap_err().to_string();
        assert!(refusal.contains(needle), "{given}: {refusal}");
    }
}

#[test]
fn times_may_be_those_of_the_moment() {
    let (schema, _) = known("std_msgs/Header");
    let given = UserInput::parse("{stamp: now, frame_id: map}").unwrap();
    let header = fill(&schema, &given, (7, 5)).unwrap();
    assert_eq!(header["stamp"], serde_json::json!({"sec": 7, "nanosec": 5}));
    let (schema, _) = known("geometry_msgs/PointStamped");
    let stamped = fill(&schema, &UserInput::parse("{header: auto}").unwrap(), (7, 5)).unwrap();
    assert_eq!(stamped["header"]["stamp"]["sec"], 7);
    let refusal = fill(&schema, &UserInput::parse("{point: auto}").unwrap(), (7, 5)).unwrap_err();
    assert!(matches!(refusal, FillError::Other { .. }), "{refusal}");
}

#[test]
fn what_echo_prints_can_be_published_again() {
    let cases: Vec<Case> = serde_json::from_str(include_str!("ros/oracle/messages.json")).unwrap();
    for Case { r#type, cdr, .. } in cases {
        let ((schema, root), cdr) = (known(&r#type), hex::decode(cdr).unwrap());
        let json = decode(&schema, &cdr);
        let view = View::of(&schema, &root, &json);
        let printed = document(&view.item(&Limits { length: usize::MAX, ..ALL }).unwrap()).unwrap();
        let again = fill(&schema, &UserInput::parse(&printed).unwrap(), (0, 0)).unwrap();
        let bytes = encode(&schema, &again);
        assert_eq!(decode(&schema, &bytes), json, "{printed}");
    }
}

fn known(kind: &str) -> (Arc<Schema>, Base) {
    let name = TypeName::parse(kind).unwrap();
    (Schema::resolve(&Registry::embedded(), Dialect::Ros2, &name).unwrap(), Base::Named(name))
}

fn decode(schema: &Arc<Schema>, cdr: &[u8]) -> Value {
    let mut json = Vec::new();
    let mapping = Mapping::within(schema, Encoding::Cdr, Encoding::Json).unwrap();
    mapping.transcode(cdr, &mut json, &Options::default()).unwrap();
    serde_json::from_slice(&json).unwrap()
}

fn encode(schema: &Arc<Schema>, json: &Value) -> Vec<u8> {
    let mut cdr = Vec::new();
    let mapping = Mapping::within(schema, Encoding::Json, Encoding::Cdr).unwrap();
    mapping.transcode(json.to_string().as_bytes(), &mut cdr, &Options::default()).unwrap();
    cdr
}
