//! Unit tests of `cli::topology`.

use super::dot::dot;
use super::*;
use serde_json::{Value, json};

#[test]
fn a_graph_has_each_adjacency_once_and_says_which_are_one_sided() {
    let name = |i: u8| Name::from_bytes([i; 32]).to_string();
    let switch = |i: u8, near: Value| json!({"switch": name(i), "bit": i, "neighbours": near, "run": 1, "number": 1, "rib": false, "borders": []});
    let reply = json!({"own": name(1), "switches": [
        switch(1, json!([{"switch": name(2), "cost": 7, "silent": false}])),
        switch(2, json!([{"switch": name(1), "cost": 5, "silent": false}, {"switch": name(3), "cost": 9, "silent": false}])),
    ]});
    let reply: TopologyReply = serde_json::from_value(reply).unwrap();
    let dot = dot(&reply, &BTreeMap::new());
    assert_eq!(dot.matches(" -- ").count(), 2, "{dot}");
    assert!(dot.contains("label = \"7\"") && dot.contains("this one"), "{dot}");
    let dashed: Vec<_> = dot.lines().filter(|line| line.contains("dashed")).collect();
    assert!(dashed.len() == 1 && dashed[0].contains("label = \"9\""), "{dot}");
    assert!(describe(&reply).concat().contains("this one"));
}
