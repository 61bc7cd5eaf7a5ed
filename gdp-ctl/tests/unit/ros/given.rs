//! Unit tests of `ros::given`.

use super::*;

#[test]
fn yaml_and_json_are_values() {
    let given = Given::parse("{a: 1, b: [true, 2.5, .inf], c: '7', d: {e: no text}, f: 0x10}").unwrap();
    let Given::Map(members) = given else { panic!("{given:?}") };
    assert_eq!(members[0], ("a".into(), Given::Integer(1)));
    let list = vec![Given::Bool(true), Given::Float(2.5), Given::Float(f64::INFINITY)];
    assert_eq!(members[1], ("b".into(), Given::List(list)));
    assert_eq!(members[2], ("c".into(), Given::Text("7".into())));
    assert_eq!(members[4], ("f".into(), Given::Integer(16)));
    assert_eq!(Given::parse(" ").unwrap(), Given::Nothing);
    assert!(Given::parse(r#"{"x": [1, -2], "y": "z"}"#).is_ok());
    assert_eq!(Given::parse("18446744073709551615").unwrap(), Given::Integer(u64::MAX.into()));
}

#[test]
fn what_is_none_is_refused() {
    for text in ["{a: 1", "a: 1\na: 2", "[1, 2", "a: 1\n b: 2"] {
        assert!(Given::parse(text).is_err(), "{text}");
    }
    let deep = "[".repeat(100_000);
    assert!(Given::parse(&deep).is_err());
}
