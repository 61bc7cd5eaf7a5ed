//! Unit tests of `cli::topology`.

use super::dot::dot;
use super::*;
use gdp_wire::Name;
use serde_json::json;

#[test]
fn a_graph_has_each_adjacency_once_and_says_which_are_one_sided() {
    let name = |i: u8| Name::from_bytes([i; 32]).to_string();
    let switch = |i: u8, near: Value| json!({"switch": name(i), "bit": i, "neighbours": near});
    let reply = json!({"own": name(1), "switches": [
        switch(1, json!([{"switch": name(2), "cost": 7}])),
        switch(2, json!([{"switch": name(1), "cost": 5}, {"switch": name(3), "cost": 9}])),
    ]});
    let dot = dot(&reply, &BTreeMap::new());
    assert_eq!(dot.matches(" -- ").count(), 2, "{dot}");
    assert!(dot.contains("label = \"7\"") && dot.contains("this one"), "{dot}");
    let dashed: Vec<_> = dot.lines().filter(|line| line.contains("dashed")).collect();
    assert!(dashed.len() == 1 && dashed[0].contains("label = \"9\""), "{dot}");
    assert!(describe(&reply).concat().contains("this one"));
}
