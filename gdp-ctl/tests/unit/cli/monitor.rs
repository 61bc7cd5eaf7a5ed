//! Unit tests of `cli::monitor`.

use super::*;
use gdp_wire::Name;

#[test]
fn what_is_suspicious_names_who_it_is_from_if_that_is_known() {
    let peer = Name::from_bytes([7; 32]);
    let line = |peer| words(&Event::Suspicious { what: "drop_source".into(), count: 12, peer });
    assert_eq!(line(None), ("suspicious", "12 × drop_source".to_owned()));
    assert_eq!(line(Some(peer)).1, format!("12 × drop_source, most over the link of {peer:#}"));
}

#[test]
fn an_event_is_a_line() {
    let peer = Name::from_bytes([7; 32]);
    let event = TimedEvent { at: 3_661_002_000_000, event: Event::LinkDown { peer, reason: "closed".into() } };
    assert_eq!(describe(&event), format!("01:01:01.002Z  link down     {peer:#}: closed"));
}
