//! Unit tests of `cli::topology::svg`.

use super::*;
use gdp_wire::Name;
use serde_json::json;

#[test]
fn a_picture_has_every_domain_switch_link_and_name() {
    let name = |i: u8| Name::from_bytes([i; 32]);
    let near = |i: u8| json!({"switch": name(i), "cost": i});
    let border = json!({"domain": name(0xd2), "switch": name(0xb1), "cost": 77, "transit": false});
    let switch = |i: u8, near: Value| json!({"switch": name(i), "bit": i, "neighbours": near, "borders": []});
    let mut first = switch(1, json!([near(2)]));
    (first["rib"], first["borders"]) = (true.into(), json!([border]));
    let reply = json!({"own": name(2), "domain": name(0xd1), "switches": [first, switch(2, json!([near(1)]))]});
    let names: Vec<_> = (0..MOST_NAMES + 2).map(|i| format!("topic<{i}>")).collect();
    let picture = svg(&reply, &BTreeMap::from([(name(2).to_string(), names)]));
    for domain in [0xd1, 0xd2] {
        assert!(picture.contains(&format!(">domain {:#}</text>", name(domain))), "{picture}");
    }
    for i in [1, 2, 0xb1] {
        assert_eq!(picture.matches(&format!(">{:#}</text>", name(i))).count(), 1, "{picture}");
    }
    assert_eq!(picture.matches("<line ").count(), 2, "{picture}");
    assert!(picture.contains(">2</text>") && picture.contains(">77</text>"), "costs: {picture}");
    assert!(picture.contains(">bit 1 · RIB</text>") && picture.contains("class=\"switch own\""), "{picture}");
    assert!(picture.contains("topic&lt;7>") && !picture.contains("topic&lt;8>"), "{picture}");
    assert!(picture.contains("… and 2 more") && picture.ends_with("</svg>"), "{picture}");
}
