//! Unit tests of `user_input`.

use super::*;

#[test]
fn yaml_and_json_are_values() {
    let given = UserInput::parse("{a: 1, b: [true, 2.5, .inf], c: '7', d: {e: no text}, f: 0x10}").unwrap();
    let UserInput::Map(members) = given else { panic!("{given:?}") };
    assert_eq!(members[0], ("a".into(), UserInput::Integer(1)));
    let list = vec![UserInput::Bool(true), UserInput::Float(2.5), UserInput::Float(f64::INFINITY)];
    assert_eq!(members[1], ("b".into(), UserInput::List(list)));
    assert_eq!(members[2], ("c".into(), UserInput::Text("7".into())));
    assert_eq!(members[4], ("f".into(), UserInput::Integer(16)));
    assert_eq!(UserInput::parse(" ").unwrap(), UserInput::Nothing);
    assert!(UserInput::parse(r#"{"x": [1, -2], "y": "z"}"#).is_ok());
    assert_eq!(UserInput::parse("18446744073709551615").unwrap(), UserInput::Integer(u64::MAX.into()));
}

#[test]
fn what_is_none_is_refused() {
    for text in ["{a: 1", "a: 1\na: 2", "[1, 2", "a: 1\n b: 2"] {
        assert!(UserInput::parse(text).is_err(), "{text}");
    }
    let deep = "[".repeat(100_000);
    assert!(UserInput::parse(&deep).is_err());
}
