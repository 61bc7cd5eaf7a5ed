//! Unit tests of `serve::graceful_restart`.

use super::*;
use gdp_core::peer::GRACEFUL_RESTART_TIME;
use gdp_link::link::LinkIds;
use gdp_wire::LinkEntry;

#[test]
fn links_go_when_their_time_is_over_and_sooner_once_replaced() {
    let (ids, now) = (LinkIds::new(), Instant::now());
    let mut hold = GracefulRestart::default();
    assert_eq!(hold.keep(link(&ids, 1, 0x401, now + GRACEFUL_RESTART_TIME)), None);
    assert_eq!(hold.keep(link(&ids, 2, 0x402, now + GRACEFUL_RESTART_TIME)), None);
    assert!(ids.reserve(0x801).is_none(), "no new link takes its place in the tables");
    hold.replaced(&name(1), 1, now);
    assert!(hold.over(now + GRACE).is_empty(), "it was another lane");
    hold.replaced(&name(1), 0, now);
    assert!(hold.over(now + GRACE / 2).is_empty());
    assert_eq!(hold.over(now + GRACE), [0x401]);
    drop(hold.take(0x401));
    assert!(!hold.keeps(&name(1)) && hold.keeps(&name(2)));
    assert!(ids.reserve(0x801).is_some());
    assert_eq!(hold.over(now + GRACEFUL_RESTART_TIME), [0x402]);
}

#[test]
fn a_peer_has_a_few_and_the_one_that_ends_first_goes() {
    let (ids, now) = (LinkIds::new(), Instant::now());
    let mut hold = GracefulRestart::default();
    for i in 0..MOST as u32 {
        assert_eq!(hold.keep(link(&ids, 1, 0x400 + i, now + GRACE * (i + 1))), None);
    }
    assert_eq!(hold.keep(link(&ids, 2, 0x420, now)), None);
    assert_eq!(hold.keep(link(&ids, 1, 0x430, now + GRACEFUL_RESTART_TIME)), Some(0x400));
}

fn link(ids: &LinkIds, peer: u8, id: u32, until: Instant) -> StaleLink {
    let entry = LinkEntry { id, ..LinkEntry::default() }.into();
    let to = LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] };
    let kept = Reservation::Adopted { _id: ids.reserve(id).unwrap() };
    let role = LinkRole::Switch;
    StaleLink { peer: name(peer), lane: 0, role, entry, to, until, answers: true, relationship: None, id: kept }
}

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}
