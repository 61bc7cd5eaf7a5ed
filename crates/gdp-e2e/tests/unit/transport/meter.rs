//! The measurement of bytes per second.

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
