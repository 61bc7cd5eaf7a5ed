//! Unit tests of `ros2::gaps`.

use super::*;

#[test]
fn a_gap_counts_once_and_late_messages_count_nothing() {
    let mut gaps = Gaps::default();
    let writer = GUID::from_bytes([1; 16]);
    let before = [7, 8, 11, 9, 12].map(|sequence| gaps.before(writer, SequenceNumber::new(sequence)));
    assert_eq!(before, [0, 0, 2, 0, 0]);
    assert_eq!(gaps.before(GUID::from_bytes([2; 16]), SequenceNumber::new(100)), 0, "a writer heard from now on");
    assert_eq!(gaps.before(writer, SequenceNumber::new(i64::MIN)), 0);
}
