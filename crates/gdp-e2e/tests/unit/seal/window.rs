//! Unit tests of `seal::window`.

use super::*;
use std::collections::BTreeSet;

#[test]
fn it_agrees_with_a_set() {
    let mut window = ReplayWindow::default();
    let (mut done, mut highest) = (BTreeSet::new(), 0u64);
    let mut random = gdp_faults::Random::new(1);
    for _ in 0..50_000 {
        let step = if random.below(500) == 0 { 3000 } else { 8 };
        let sequence = (highest + random.below(step)).saturating_sub(random.below(1100)).max(1);
        let expected = if highest >= SPAN && sequence <= highest - SPAN {
            Err(DropReason::TooOld)
        } else if done.contains(&sequence) {
            Err(DropReason::Duplicate)
        } else {
            Ok(())
        };
        assert_eq!(window.check(sequence), expected, "{sequence} of {highest}");
        if expected.is_ok() {
            window.record(sequence);
            done.insert(sequence);
            highest = highest.max(sequence);
        }
    }
}

#[test]
fn the_ends_of_the_number_range() {
    let mut window = ReplayWindow::default();
    window.record(u64::MAX);
    assert_eq!(window.check(u64::MAX), Err(DropReason::Duplicate));
    assert_eq!(window.check(1), Err(DropReason::TooOld));
    assert_eq!(window.check(u64::MAX - 1023), Ok(()));
    window.record(1);
    assert_eq!(window.check(u64::MAX - 1023), Ok(()));
}
