//! Unit tests of `serve::recent_refusals`.

use super::*;

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}

#[test]
fn refusals_are_counted_for_a_minute_by_peer_and_thing() {
    let start = Instant::now();
    let at = |seconds| start + Duration::from_secs(seconds);
    let mut refusals = RecentRefusals::new(start);
    for second in [1, 2, 30] {
        refusals.add(name(1), RefusedThing::Link, None, &format!("no membership at {second}"), at(second));
    }
    refusals.add(name(1), RefusedThing::Registration, Some(RefusalCode::Revoked), "revoked", at(31));
    let all = refusals.all(at(40));
    let shown: Vec<_> = all.iter().map(|it| (it.what.as_str(), it.count, it.reason.as_str(), it.age_s)).collect();
    assert_eq!(shown, [("registration", 1, "revoked", 9), ("link", 3, "no membership at 30", 10)]);
    assert_eq!(refusals.all(at(65)).iter().map(|it| it.count).collect::<Vec<_>>(), [1, 1], "two are over");
    assert_eq!(refusals.all(at(95)), []);
    refusals.add(name(1), RefusedThing::Link, None, "again", at(300));
    assert_eq!(refusals.all(at(300))[0].count, 1);
    refusals.add(name(1), RefusedThing::Link, None, "the clock went back", at(10));
    assert_eq!(refusals.all(at(300))[0].count, 2, "which is no reason to forget");
    let total = |what: &str, kind: &str| refusals.total()[what][kind];
    assert_eq!((total("link", "NotAdmitted"), total("registration", "Revoked")), (5, 1), "since the start");
}

#[test]
fn only_another_reason_is_news() {
    let start = Instant::now();
    let mut refusals = RecentRefusals::new(start);
    let mut add = |peer, reason, seconds| {
        refusals.add(name(peer), RefusedThing::Link, None, reason, start + Duration::from_secs(seconds))
    };
    let news = [add(1, "ended 1 s ago", 1), add(1, "ended 2 s ago", 2), add(1, "revoked", 3), add(2, "revoked", 3)];
    assert_eq!(news, [true, false, true, true]);
    assert!(add(1, "revoked", 300), "a minute without it");
}

#[test]
fn a_flood_of_peers_and_long_reasons_are_bounded() {
    let start = Instant::now();
    let mut refusals = RecentRefusals::new(start);
    for i in 0..200u8 {
        let at = start + Duration::from_millis(u64::from(i));
        refusals.add(name(i), RefusedThing::Link, None, &"é".repeat(1000), at);
    }
    let all = refusals.all(start);
    assert_eq!((all.len(), all[0].peer), (MAX_ENTRIES, name(199)));
    assert!(all.iter().all(|it| it.reason.len() <= MAX_REASON));
}
