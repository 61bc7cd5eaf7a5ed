//! Unit tests of `yaml`.

use super::*;
use serde::Deserialize;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    identity: String,
    plane: Plane,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Plane {
    Xdp,
    Userspace,
}

#[test]
fn an_error_names_the_line_and_the_nearest_key() {
    let file = parse::<File>("identity: a\nplane: xdp\n").unwrap();
    assert!(file.identity == "a" && matches!(file.plane, Plane::Xdp));
    for (text, expected) in [
        ("identty: a\n", "there is no key `identty`; did you mean `identity`? at line 1, column 1"),
        ("identity: a\nzz: 1\n", "there is no key `zz`; there is identity, plane at line 2"),
        ("identity: a\nplane: user_space\n", "there is no value `user_space`; did you mean `userspace`? at line 2"),
        ("identity: a\n\tplane: xdp\n", "a tab; use spaces, because YAML allows no tabs here"),
        ("identity: a\nplane:\n\t- xdp\n", "a tab; use spaces, because YAML allows no tabs here at line 3"),
    ] {
        let error = parse::<File>(text).unwrap_err();
        assert!(error.contains(expected), "{error}");
        assert_eq!((error.lines().count(), error.matches("at line").count()), (1, 1), "{error}");
    }
    let secret = parse::<File>("c2VjcmV0\n").unwrap_err();
    assert!(!secret.contains("c2VjcmV0"), "{secret}");
}
