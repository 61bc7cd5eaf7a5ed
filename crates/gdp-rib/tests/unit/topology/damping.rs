//! Unit tests of `topology::damping`, in virtual time.

use super::*;

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn a_link_that_fails_once_or_twice_is_used_again_at_once() {
    let mut damper = Damper::default();
    damper.failed(SECOND);
    assert!(!damper.is_suppressed());
    damper.failed(2 * SECOND);
    assert!(!damper.is_suppressed());
    assert!(!damper.is_clear(10 * SECOND));
    assert!(damper.is_clear(100 * SECOND));
}

#[test]
fn a_link_that_flaps_is_suppressed_until_it_has_been_steady() {
    let mut damper = Damper::default();
    (1..=3).for_each(|at| damper.failed(at * SECOND));
    assert!(damper.is_suppressed());
    assert!(!damper.follow(10 * SECOND));
    let until = (11..60).find(|at| damper.follow(*at * SECOND));
    assert!(until.is_some_and(|until| (15..25).contains(&until)), "{until:?}");
    assert!(!damper.is_suppressed());
    damper.failed(20 * SECOND);
    damper.failed(21 * SECOND);
    assert!(damper.is_suppressed(), "what was before still counts");
}

#[test]
fn no_link_is_suppressed_for_more_than_a_minute() {
    let mut damper = Damper::default();
    (1..=10_000).for_each(|at| damper.failed(at * SECOND / 10));
    assert!(damper.is_suppressed());
    assert!(damper.follow(1000 * SECOND + LONGEST + SECOND));
}

#[test]
fn rare_failures_are_no_flapping() {
    let mut damper = Damper::default();
    for at in 1..100 {
        damper.failed(20 * at * SECOND);
        assert!(!damper.is_suppressed());
    }
}
