//! Unit tests of `node::pause`.

use super::*;
use std::future::{pending, ready};

/// A pause that no test waits for.
const LONG: Duration = Duration::from_secs(600);

#[tokio::test]
async fn news_cut_a_pause_short_but_not_without_end() {
    let (mut hurry, start) = (ExpediteToken::default(), Instant::now());
    for attempts in 0..3 * AT_ONCE {
        let first = Backoff::new(HURRIED, LONG);
        let mut backoff = first;
        while backoff.next_delay() < LONG {}
        hurry.pause(&mut backoff, ready(()), false).await;
        assert_eq!(backoff, first, "it begins again");
        let least = attempts / AT_ONCE * AT_ONCE * HURRIED;
        assert!(start.elapsed() >= least, "{attempts} attempts after {:?}", start.elapsed());
    }
    assert!(start.elapsed() < LONG / 2);
}

#[tokio::test]
async fn news_that_may_be_of_no_use_leave_pauses_long_and_come_apart() {
    let (mut hurry, mut backoff, start) = (ExpediteToken::default(), Backoff::new(LONG, LONG), Instant::now());
    for _ in 0..=AT_ONCE {
        hurry.pause(&mut backoff, ready(()), true).await;
    }
    assert!(start.elapsed() >= AT_ONCE * BLIND && backoff.next_delay() == LONG);
}

#[tokio::test]
async fn without_news_pauses_grow() {
    let (mut hurry, mut backoff) = (ExpediteToken::default(), Backoff::new(Duration::from_millis(2), LONG));
    hurry.pause(&mut backoff, pending(), false).await;
    assert!(backoff.next_delay() == Duration::from_millis(4) && hurry.0.is_empty());
}
