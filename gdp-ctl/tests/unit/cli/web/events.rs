//! The latest events are stored, with harmless texts.

use gdp_proto::admin::event::Event;
use gdp_wire::Name;

use super::*;

#[test]
fn the_latest_hundred_are_stored_and_texts_of_peers_are_escaped() {
    let events = RecentEvents::default();
    for at in 0..120 {
        let reason = format!("\u{1b}[2J\u{202e}{at}");
        let event = Event::LinkDown { peer: Name::from_bytes([7; 32]), reason };
        events.add(&TimedEvent { at: at * 1_000_000, event });
    }
    let latest = events.latest();
    assert_eq!((latest.len(), latest[0].at_ms, latest[99].at_ms), (100, 119, 20));
    assert_eq!(latest[0].kind, "link down");
    assert!(latest[0].what.ends_with("\\u{1b}[2J\\u{202e}119"), "{}", latest[0].what);
}
