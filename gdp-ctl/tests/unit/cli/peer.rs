//! Unit tests of `cli::peer`.

use super::*;
use gdp_wire::Name;
use serde_json::json;

#[test]
fn a_peer_without_a_link_has_a_reason() {
    let (home, away, peer) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]), Name::from_bytes([3; 32]));
    let up = json!({"peer": peer, "listed": true, "domain": away, "relationship": "border", "rights_granted": "peering",
        "rights_received": "peering,transit", "until": unix_seconds() + 1000, "link": "up", "via": "e0", "reason": null});
    let down = json!({"peer": peer, "listed": true, "domain": null, "relationship": null, "link": "down", "via": "e1",
        "reason": "nobody answers", "reason_age_s": 7});
    let lines = describe(&serde_json::from_value(json!({"domain": home, "peers": [up, down]})).unwrap());
    assert!(lines[1].contains(&format!("{away:#}")) && lines[1].contains("peering,transit"), "{lines:?}");
    assert!(lines[2].ends_with("nobody answers (7 s ago)"), "{lines:?}");
}
