//! Unit tests of `cli::link`.

use super::{arrivals, duration};

#[test]
fn drops_are_named() {
    let counts = [("forwarded", 7), ("drop_bad_tag", 2), ("drop_replayed", 1)].map(|(name, n)| (name.to_owned(), n));
    assert_eq!(arrivals(&counts.into()), ("10".into(), "bad_tag 2, replayed 1".into()));
    assert_eq!(arrivals(&[].into()), ("0".into(), String::new()));
}

#[test]
fn ages_are_told_in_two_units() {
    for (seconds, text) in [(0, "0s"), (59, "59s"), (61, "1m 1s"), (12_000, "3h 20m"), (90_000, "1d 1h")] {
        assert_eq!(duration(seconds), text);
    }
}
