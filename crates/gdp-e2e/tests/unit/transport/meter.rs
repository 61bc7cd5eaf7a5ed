//! The token bucket.

use super::*;

const SECOND: u64 = 1_000_000_000;

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
