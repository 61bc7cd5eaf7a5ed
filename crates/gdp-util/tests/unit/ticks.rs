//! Unit tests of `ticks`.

use super::*;

#[test]
fn periodic_work_that_began_at_any_time_meets_at_a_tick() {
    let period = Duration::from_millis(500);
    // All ticks count from the first call.
    next_tick(period, Instant::now());
    let now = Instant::now();
    let first = next_tick(period, now);
    assert!(first > now && first <= now + period);
    for later in [0, 1, 100_000_000, 499_999_999] {
        let tick = next_tick(period, first + Duration::from_nanos(later));
        assert_eq!(tick, first + period, "{later} ns later");
    }
    // The ticks of a multiple of the period are among those of the period.
    let slow = next_tick(4 * period, now);
    assert_eq!((slow - first).as_nanos() % period.as_nanos(), 0);
}
