//! The token bucket, and the count of recent bytes.

use super::*;

const SECOND: u64 = 1_000_000_000;

#[test]
fn recent_bytes_are_forgotten_and_time_may_step_back() {
    let mut recent = Recent::new(10 * SECOND);
    recent.add(16 * SECOND, 1000);
    recent.add(14 * SECOND, 1000);
    assert_eq!(recent.get(9 * SECOND), 2000);
    assert_eq!(recent.get(24 * SECOND), 2000);
    assert_eq!(recent.get(25 * SECOND), 0);
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
