//! Unit tests of `ros::yaml`.

use super::*;

/// Parsing PyYAML's output and this program's output of each text gives the same text.
#[test]
fn texts_are_read_as_they_were() {
    let cases: Vec<(String, String)> = serde_json::from_str(include_str!("oracle/texts.json")).unwrap();
    for (value, _) in cases {
        let printed = document(&Item::Map(vec![("data".into(), Item::Text(value.clone()))])).unwrap();
        let read: serde_json::Value = serde_saphyr::from_str(&printed).unwrap();
        assert_eq!(read["data"], value, "{printed}");
        assert_eq!(printed.lines().count(), 1, "{printed}");
    }
}
