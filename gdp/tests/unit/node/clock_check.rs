//! Unit tests of `clock_check`.

use super::*;

const SECOND: u64 = 1000 * MS;

#[test]
fn a_question_is_repeated_until_it_is_answered_and_then_rests() {
    let mut check = ClockCheck::default();
    assert_eq!((check.poll(0), check.next_wake()), (None, None), "nothing was too old");
    check.too_old(0).unwrap();
    let first = check.poll(0).unwrap();
    check.too_old(1).unwrap();
    assert_eq!((check.poll(1), check.poll(RETRY)), (None, Some(first)), "the answer may have been lost");

    let (own, theirs) = (5000 * SECOND, 1400 * SECOND);
    assert_eq!(check.answered(RETRY, &[0; 16], own, theirs), None, "not to this question");
    assert_eq!(check.answered(RETRY + 2 * MS, &first, own, theirs), Some(-3600 * SECOND as i64 + MS as i64));
    assert_eq!(check.answered(RETRY, &first, own, theirs), None, "a recording");
    assert_eq!(check.next_wake(), None);

    check.too_old(SECOND).unwrap();
    assert_eq!(check.poll(AGAIN), None);
    assert_ne!(check.poll(RETRY + AGAIN).unwrap(), first);
}

#[test]
fn a_writer_that_does_not_know_the_question_is_left_alone() {
    let mut check = ClockCheck::default();
    check.too_old(0).unwrap();
    let mut times = Vec::new();
    while let Some(at) = check.next_wake() {
        check.poll(at).unwrap();
        times.push(at);
    }
    assert_eq!(times, (0..5).map(|i| i * RETRY).collect::<Vec<_>>());
    check.too_old(4 * RETRY).unwrap();
    assert_eq!(check.next_wake(), Some(4 * RETRY + AGAIN));
}
