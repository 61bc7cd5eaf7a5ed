//! Unit tests of `cli::monitor`.

use super::*;
use gdp_wire::Name;
use serde_json::json;

#[test]
fn an_event_is_a_line() {
    let peer = Name::from_bytes([7; 32]);
    let event = json!({"event": "link_down", "peer": peer, "reason": "closed", "at": 3_661_002_000_000u64});
    assert_eq!(describe(&event), format!("01:01:01.002Z  link down     {peer:#}: closed"));
}
