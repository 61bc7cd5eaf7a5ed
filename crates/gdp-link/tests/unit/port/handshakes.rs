//! Unit tests of `port::handshakes`.

use super::*;

fn address(i: usize) -> IpAddr {
    IpAddr::from([10, 0, (i >> 8) as u8, i as u8])
}

fn start(handshakes: &Handshakes, now: Instant, i: usize) -> Started {
    match handshakes.admit(now, address(i), false) {
        Verdict::Start(started) => started,
        other => panic!("{other:?}"),
    }
}

#[test]
fn one_address_has_its_share_and_leaves_it_again() {
    let (handshakes, now) = (Handshakes::new(HandshakeCounters::default()), Instant::now());
    let half = MAX_HANDSHAKES_OF_ONE / 2;
    let mut of_one: Vec<_> = (0..half).map(|_| start(&handshakes, now, 1)).collect();
    assert!(matches!(handshakes.admit(now, address(1), true), Verdict::Challenge), "perhaps it is not of that address");
    of_one.extend((half..MAX_HANDSHAKES_OF_ONE).map(|_| start(&handshakes, now, 1)));
    assert!(matches!(handshakes.admit(now, address(1), false), Verdict::Ignore));
    start(&handshakes, now, 2);
    of_one.pop();
    start(&handshakes, now, 1);
    assert_eq!(handshakes.counters.read(), HandshakeCounts { challenged: 1, refused: 1, ..Default::default() });
}

#[tokio::test]
async fn beyond_half_addresses_are_to_be_proven_and_beyond_all_the_oldest_gives_way() {
    let (handshakes, now) = (Handshakes::new(HandshakeCounters::default()), Instant::now());
    let mut started: Vec<_> = (0..MAX_HANDSHAKES / 2).map(|i| start(&handshakes, now, i)).collect();
    assert!(matches!(handshakes.admit(now, address(1000), true), Verdict::Challenge));
    let oldest = tokio::spawn(std::future::pending::<()>());
    started[0].runs_as(oldest.abort_handle());
    started.extend((MAX_HANDSHAKES / 2..MAX_HANDSHAKES).map(|i| start(&handshakes, now, i)));
    assert!(matches!(handshakes.admit(now, address(1000), false), Verdict::Ignore), "the oldest is young");
    let now = now + MIN_AGE;
    started.push(start(&handshakes, now, 1000));
    assert!(oldest.await.is_err_and(|error| error.is_cancelled()));
    assert_eq!(handshakes.lock().entries.len(), MAX_HANDSHAKES);
    // A handshake that is displaced before its task is known.
    started.push(start(&handshakes, now, 1001));
    let late = tokio::spawn(std::future::pending::<()>());
    started[1].runs_as(late.abort_handle());
    assert!(late.await.is_err());
    let counts = HandshakeCounts { challenged: 1, refused: 1, displaced: 2, failed: 0 };
    assert_eq!(handshakes.counters.read(), counts);
    drop(started);
    assert!(handshakes.lock().entries.is_empty());
}
