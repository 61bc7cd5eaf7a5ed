//! Unit tests of `route::pending_match`.

use super::*;

#[test]
fn it_waits_for_the_first_subscriber_and_no_longer_than_it_may() {
    let now = Instant::now();
    let is_over = |pending: &mut PendingMatch<u8>, now, is_matched: bool| {
        pending.push(1, 1);
        !pending.take(now, || is_matched).is_empty()
    };
    for (is_reliable, patience) in [(true, RELIABLE_PATIENCE), (false, TIMEOUT)] {
        let mut pending = PendingMatch::new(now, is_reliable);
        assert!(!is_over(&mut pending, now + patience - SETTLE / 2, false));
        assert!(is_over(&mut pending, now + patience, false));
    }
    let mut pending = PendingMatch::new(now, false);
    assert!(!is_over(&mut pending, now + SETTLE, true) && !pending.is_done());
    assert!(is_over(&mut pending, now + 2 * SETTLE, false), "it has matched before");
    let mut late = PendingMatch::new(now, false);
    assert!(!is_over(&mut late, now + TIMEOUT - SETTLE / 2, true) && is_over(&mut late, now + TIMEOUT, true));
}

#[test]
fn what_waits_is_bounded() {
    let now = Instant::now();
    let (mut many, mut large) = (PendingMatch::new(now, true), PendingMatch::new(now, true));
    (0..=MAX_WAITING).for_each(|i| many.push(i, 1));
    large.push(0, MAX_WAITING_BYTES + 1);
    assert_eq!(
        (large.waiting(), large.drop_oldest(), large.bytes(), large.drop_oldest()),
        (1, MAX_WAITING_BYTES + 1, 0, 0)
    );
    large.push(0, MAX_WAITING_BYTES + 1);
    assert!(!many.take(now, || false).is_empty() && !large.take(now, || false).is_empty());
    assert_eq!((large.bytes(), large.waiting(), large.is_done()), (0, 0, true));
}

#[test]
fn what_waited_is_released_in_portions_and_in_order() {
    let now = Instant::now();
    let mut pending = PendingMatch::new(now, true);
    (0..14_u32).for_each(|i| pending.push(i, 1));
    assert!(pending.take(now, || false).is_empty());
    let later = now + RELIABLE_PATIENCE;
    let mut taken = pending.take(later, || false);
    assert_eq!(taken, [0, 1, 2]);
    // Later messages queue behind.
    pending.push(14, 1);
    for _ in 1..PORTIONS {
        assert!(!pending.is_done());
        let portion = pending.take(later, || unreachable!("it is over"));
        assert!(portion.len() <= 3, "{portion:?}");
        taken.extend(portion);
    }
    assert_eq!(taken, (0..15).collect::<Vec<_>>());
    assert!(pending.is_done() && pending.bytes() == 0);
    pending.push(15, 1);
    assert_eq!(pending.take(later, || false), [15]);
}
