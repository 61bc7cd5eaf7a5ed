//! Unit tests of `date`.

use super::*;

#[test]
fn times_are_those_of_the_gregorian_calendar() {
    for (seconds, expected) in [
        (0, "1970-01-01T00:00:00Z"),
        (951_782_399, "2000-02-28T23:59:59Z"),
        (951_782_400, "2000-02-29T00:00:00Z"),
        (1_709_251_199, "2024-02-29T23:59:59Z"),
        (1_735_689_599, "2024-12-31T23:59:59Z"),
        (1_795_436_954, "2026-11-23T12:29:14Z"),
        (4_107_542_400, "2100-03-01T00:00:00Z"),
        (LAST, "9999-12-31T23:59:59Z"),
        (LAST + 1, "after the year 9999"),
        (u64::MAX, "after the year 9999"),
    ] {
        assert_eq!(rfc3339(seconds), expected, "{seconds}");
    }
}

#[test]
fn a_relative_time_has_the_date_and_the_distance() {
    let now = 1_795_436_955;
    for (at, expected) in [
        (now - 1, "2026-11-23T12:29:14Z, 1 s ago"),
        (now, "2026-11-23T12:29:15Z, now"),
        (now + 86_399, "2026-11-24T12:29:14Z, in 24 h"),
        (now + 365 * 86_400 - 1, "2027-11-23T12:29:14Z, in 365 d"),
        (u64::MAX, "after the year 9999"),
    ] {
        assert_eq!(relative(at, now), expected);
    }
    let spans = [0, 119, 120, 900, 7_200, 90_000, 604_799].map(rounded);
    assert_eq!(spans, ["0 s", "119 s", "2 min", "15 min", "2 h", "25 h", "7 d"]);
    assert!(rounded(u64::MAX).ends_with(" d"));
}
