//! Unit tests of `peer_proxies`.

use super::*;

#[test]
fn the_lowest_that_is_able_carries() {
    let now = Instant::now();
    let [low, mid, high] = [1, 2, 3].map(|i| (Arc::new(PeerProxies::default()), Name::from_bytes([i; 32])));
    let tell = |now| {
        for (from, _) in [&low, &mid, &high] {
            let Some(text) = from.claims() else { continue };
            [&low, &mid, &high].iter().for_each(|(to, _)| to.receive(now, &text).unwrap());
        }
    };
    let candidate = |of: &(Arc<PeerProxies>, Name), part: RoutePart| of.0.enter(of.1, part, true);
    let (b, c) = (candidate(&mid, part(Side::Out)), candidate(&high, part(Side::Out)));
    assert_eq!((b.ahead(now), c.ahead(now)), (None, None), "nobody is waited for");
    tell(now);
    assert_eq!((b.ahead(now), c.ahead(now)), (None, Some(mid.1)));
    let a = candidate(&low, part(Side::Out));
    tell(now);
    assert_eq!((a.ahead(now), b.ahead(now), c.ahead(now)), (None, Some(low.1), Some(low.1)));
    a.set_attached(false);
    tell(now);
    assert_eq!((b.ahead(now), c.ahead(now)), (None, Some(mid.1)));
    drop(b);
    tell(now);
    assert_eq!(c.ahead(now), None);
    a.set_attached(true);
    tell(now);
    assert_eq!((c.ahead(now), c.ahead(now + DEAD_INTERVAL)), (Some(low.1), None), "not heard of any more");
    // Back after it could not, and not shown yet that it can.
    drop(a);
    let a = low.0.enter(low.1, part(Side::Out), false);
    tell(now);
    assert_eq!(c.ahead(now), None);
    a.set_permitted(true);
    tell(now);
    assert_eq!(c.ahead(now), Some(low.1));
}

#[test]
fn what_is_kept_stays_with_who_has_it_and_of_two_that_have_it_the_lowest_goes_on() {
    let now = Instant::now();
    let [low, high] = [1, 2].map(|i| (Arc::new(PeerProxies::default()), Name::from_bytes([i; 32])));
    let tell = |from: &(Arc<PeerProxies>, Name), to: &(Arc<PeerProxies>, Name)| {
        to.0.receive(now, &from.0.claims().unwrap()).unwrap();
    };
    let [a, b] = [&low, &high].map(|of| of.0.enter(of.1, part(Side::In), true));
    b.set_keeps(true);
    tell(&high, &low);
    tell(&low, &high);
    assert_eq!((a.ahead(now), b.ahead(now)), (Some(high.1), None), "the one that has it");
    b.set_attached(false);
    tell(&high, &low);
    assert_eq!(a.ahead(now), None, "it cannot any more");
    a.set_keeps(true);
    tell(&low, &high);
    assert_eq!(b.ahead(now), Some(low.1));
    b.set_attached(true);
    tell(&high, &low);
    assert_eq!((a.ahead(now), b.ahead(now)), (None, Some(low.1)), "both have it");
}

#[test]
fn another_kind_or_direction_is_another_part() {
    let (now, [low, high]) = (Instant::now(), [1, 2].map(|i| Name::from_bytes([i; 32])));
    let (here, there) = (Arc::new(PeerProxies::default()), Arc::new(PeerProxies::default()));
    let _theirs = there.enter(low, part(Side::Out), true);
    let ours = here.enter(high, part(Side::In), true);
    let other = here.enter(high, RoutePart { title: "service /chatter".into(), ..part(Side::Out) }, true);
    here.receive(now, &there.claims().unwrap()).unwrap();
    assert_eq!((ours.ahead(now), other.ahead(now)), (None, None));
    assert!(ours.is_twin(now, &low) && !ours.is_twin(now, &high) && !ours.is_twin(now + DEAD_INTERVAL, &low));
}

#[test]
fn what_others_say_is_bounded() {
    let (now, peer_proxies) = (Instant::now(), PeerProxies::default());
    let claims = |entity: u8, version, parts: usize| {
        let able = (0..parts).map(|i| (RoutePart { title: format!("topic /{i}"), ..part(Side::In) }, false)).collect();
        serde_json::to_string(&Claims { version, entity: Name::from_bytes([entity; 32]), able }).unwrap()
    };
    let refused = |text: &str| peer_proxies.receive(now, text).unwrap_err().to_string();
    assert!(refused("{}").contains("not understood"));
    assert!(refused(r#"{"version":1,"entity":"x","able":["y"]}"#).contains("version 1"));
    assert!(refused(&claims(1, 3, 0)).contains("version 3"));
    assert!(refused(&claims(1, 2, MAX_PARTS + 1)).contains(&format!("parts: {}", MAX_PARTS + 1)));
    (0..MAX_OTHERS as u8).for_each(|i| peer_proxies.receive(now, &claims(i, 2, 1)).unwrap());
    assert!(refused(&claims(99, 2, 1)).contains("proxies in a graph: 65"));
    peer_proxies.receive(now + DEAD_INTERVAL, &claims(99, 2, 1)).unwrap();
}

fn part(side: Side) -> RoutePart {
    RoutePart { name: Name::from_bytes([9; 32]), side, title: "topic /chatter".into() }
}
