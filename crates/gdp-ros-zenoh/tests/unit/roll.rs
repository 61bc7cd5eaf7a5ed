//! Tests of [`super`].

use super::*;

#[test]
fn names_of_nodes_are_checked() {
    assert!(is_node("/talker") && is_node("/robot/driver_1"));
    for text in ["", "/", "talker", "/a//b", "/a/", "/a/**", "/a%b", "/\u{e9}", &format!("/{}", "a".repeat(255))] {
        assert!(!is_node(text), "{text}");
    }
}
