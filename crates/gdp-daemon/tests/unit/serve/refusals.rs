//! Unit tests of `serve::refusals`.

use super::*;
use std::time::Duration;

#[test]
fn the_oldest_make_room() {
    let (mut refusals, start) = (Refusals::default(), Instant::now());
    let name = |i: u8| Name::from_bytes([i; 32]);
    for i in 0..=MAX_PEERS as u8 {
        refusals.add(name(i), i.to_string(), start + Duration::from_secs(i.into()));
    }
    assert_eq!(refusals.iter().count(), MAX_PEERS);
    assert!(refusals.iter().all(|(peer, _)| *peer != name(0)));
    refusals.add(name(9), "again".into(), start);
    assert_eq!(refusals.iter().count(), MAX_PEERS, "a peer that is there takes no room");
    refusals.forget(&name(9));
    assert!(refusals.iter().all(|(_, refused)| refused.reason != "again"));
}
