//! The token bucket, and the measurement of bytes per second.

use super::*;

const SECOND: u64 = 1_000_000_000;

#[test]
fn an_earlier_time_after_a_later_one_counts_as_the_later_one() {
    let mut speed = Speed::new(10 * SECOND);
    speed.add(12 * SECOND, 1000);
    speed.add(11 * SECOND, 1000);
    assert_eq!(speed.get(9 * SECOND), 4000, "2000 bytes in half a second");
    assert_eq!(speed.get(12 * SECOND), 4000);
}

/// At a kilobyte a millisecond.
#[test]
fn a_token_bucket_keeps_the_credit_of_a_late_sender() {
    let ms = SECOND / 1000;
    for (late, ready) in [(0, 101), (25 * ms, 76), (1000 * ms, 11)] {
        let mut meter = Meter::new(10 * ms);
        meter.take_late(100 * ms, 1000, 1_000_000, late);
        assert_eq!(meter.ready_at(0), ready * ms);
    }
}
