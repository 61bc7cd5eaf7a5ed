//! Unit tests of `ros2::raw`.

use super::*;

#[test]
fn source_timestamps_keep_their_value() {
    let ns = 1_700_000_000_123_456_789;
    let back = nanoseconds(timestamp(ns));
    assert!(ns - back <= 1, "{back}");
    assert!(timestamp(u64::MAX) < Timestamp::INFINITE, "a time after 2106 is not passed on");
}
