//! Unit tests of `cli::monitor`.

use super::*;
use gdp_wire::Name;

#[test]
fn an_event_is_a_line() {
    let peer = Name::from_bytes([7; 32]);
    let event = TimedEvent { at: 3_661_002_000_000, event: Event::LinkDown { peer, reason: "closed".into() } };
    assert_eq!(describe(&event), format!("01:01:01.002Z  link down     {peer:#}: closed"));
}
