//! Unit tests of `serve::events`.

use super::*;
use gdp_wire::Name;

#[tokio::test]
async fn a_slow_listener_is_told_how_much_it_missed() {
    let events = Events::default();
    let entity = Name::from_bytes([1; 32]);
    events.tell(Event::Detached { entity });
    let mut listener = events.listen();
    for changes in 0..MAX_WAITING + 3 {
        events.tell(Event::Routes { generation: 1, changes });
    }
    let missed = listener.next().await.unwrap();
    assert_eq!(missed.event, Event::Missed { events: 3 });
    let next = listener.next().await.unwrap();
    assert_eq!(next.event, Event::Routes { generation: 1, changes: 3 }, "and goes on with the oldest");
    drop(events);
    for _ in 0..MAX_WAITING - 1 {
        assert!(listener.next().await.is_some());
    }
    assert!(listener.next().await.is_none());
}
