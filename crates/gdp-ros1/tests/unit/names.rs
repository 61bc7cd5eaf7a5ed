//! Unit tests of `names`.

use super::*;

#[test]
fn names_are_resolved_as_the_wiki_says() {
    for (name, node, full) in [
        ("bar", "/node1", "/bar"),
        ("bar", "/wg/node2", "/wg/bar"),
        ("/bar", "/wg/node2", "/bar"),
        ("~bar", "/node1", "/node1/bar"),
        ("foo/bar", "/wg/node3", "/wg/foo/bar"),
        ("~foo/bar", "/wg/node3", "/wg/node3/foo/bar"),
    ] {
        assert_eq!(resolve(name, node).as_deref(), Ok(full), "{name} of {node}");
    }
}

#[test]
fn what_is_no_name_is_refused_with_the_reason() {
    assert_eq!(resolve("", "/n"), Err(NameError::Empty));
    for (name, bad, at) in [("a b", ' ', 1), ("1a", '1', 0), ("/a~b", '~', 2), ("ä", 'ä', 0), ("a\n", '\n', 1)] {
        assert_eq!(resolve(name, "/n"), Err(NameError::Character { name: name.to_owned(), bad, at }));
    }
    for name in ["/", "~", "a//b", "/a/", "//a", "~/a"] {
        assert_eq!(resolve(name, "/n"), Err(NameError::EmptyPart { name: name.to_owned() }));
    }
    assert_eq!(resolve(&"a".repeat(1025), "/n"), Err(NameError::TooLong(1025)));
    assert_eq!(resolve("a", &format!("/{}/n", "b".repeat(1023))), Err(NameError::TooLong(1026)));
    assert_eq!(validate_node("n"), Err(NameError::NotFull("n".to_owned())));
    assert_eq!(validate_node("/ns/n"), Ok(()));
}
