//! Unit tests of `stamps`.

use super::*;

const SECOND: u64 = 1_000_000_000;
const NOW: u64 = 1_800_000_000 * SECOND;

#[test]
fn a_clock_that_is_set_back_by_an_hour_does_not_count_until_it_has_caught_up() {
    let stamps = Stamps::default();
    let hour = 3600 * SECOND;
    assert_eq!(stamps.next(SECOND, NOW), NOW);
    assert_eq!(stamps.next(2 * SECOND, NOW + SECOND - hour), NOW + SECOND);
    assert_eq!(stamps.next(9 * SECOND, NOW + 8 * SECOND - hour), NOW + 8 * SECOND, "it goes on");
    assert_eq!(stamps.next(10 * SECOND, NOW + 9 * SECOND), NOW + 9 * SECOND, "the clock was mended");
    assert_eq!(stamps.next(11 * SECOND, NOW + 10 * SECOND + hour), NOW + 10 * SECOND + hour, "forward");
}

#[test]
fn small_corrections_and_absurd_times_are_followed() {
    let stamps = Stamps::default();
    assert_eq!(stamps.next(SECOND, NOW), NOW);
    assert_eq!(stamps.next(2 * SECOND, NOW + SECOND / 2), NOW + SECOND / 2);
    let days = 48 * 3600 * SECOND;
    assert_eq!(stamps.next(3 * SECOND, NOW - days), NOW - days, "it was wrong before");
    for unix in [u64::MAX, 0, NOW] {
        assert_eq!(stamps.next(u64::MAX, unix), unix);
    }
}
