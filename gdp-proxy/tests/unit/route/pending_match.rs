//! Unit tests of `route::hold`.

use super::*;

#[test]
fn it_waits_for_the_first_subscriber_and_no_longer_than_it_may() {
    let now = Instant::now();
    for (is_reliable, patience) in [(true, RELIABLE_PATIENCE), (false, TIMEOUT)] {
        let mut hold = PendingMatch::<u8>::new(now, is_reliable);
        assert!(!hold.is_over(now + patience - SETTLE / 2, || false) && hold.is_over(now + patience, || false));
    }
    let mut hold = PendingMatch::new(now, false);
    hold.push('a', 1);
    assert!(!hold.is_over(now + SETTLE, || true) && !hold.is_over(now + SETTLE, || unreachable!("it is known")));
    assert!(hold.is_over(now + 2 * SETTLE, || true));
    assert_eq!(hold.into_waiting().collect::<Vec<_>>(), ['a']);
    let mut late = PendingMatch::<u8>::new(now, false);
    assert!(!late.is_over(now + TIMEOUT - SETTLE / 2, || true) && late.is_over(now + TIMEOUT, || true));
}

#[test]
fn what_waits_is_bounded() {
    let now = Instant::now();
    let (mut many, mut large) = (PendingMatch::new(now, true), PendingMatch::new(now, true));
    (0..=MAX_WAITING).for_each(|i| many.push(i, 1));
    large.push(0, MAX_WAITING_BYTES + 1);
    assert!(many.is_over(now, || false) && large.is_over(now, || false));
    assert_eq!((large.drop_oldest(), large.bytes(), large.drop_oldest()), (MAX_WAITING_BYTES + 1, 0, 0));
}
