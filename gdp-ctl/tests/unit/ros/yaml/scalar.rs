//! Unit tests of `ros::yaml::scalar`.

use super::*;

/// What PyYAML prints; see `oracle/generate.py`.
#[test]
fn text_is_quoted_as_pyyaml_does() {
    let cases: Vec<(String, String)> = serde_json::from_str(include_str!("../oracle/texts.json")).unwrap();
    for (value, printed) in cases {
        assert_eq!(text(&value, 2), printed, "{value:?}");
    }
}
