//! Unit tests of `ros2::presence`.

use super::*;

#[test]
fn what_is_written_is_read_and_nonsense_is_nothing() {
    assert_eq!(read(&written("{}")), b"{}");
    for bytes in [&[0, 1, 0, 0][..], &[0, 1, 0, 0, 9, 0, 0, 0, 1], &[0, 1, 0, 0, 0, 0, 0, 0]] {
        assert_eq!(read(&RawSample { representation: Representation::CdrLe, bytes: bytes.to_vec().into() }), b"");
    }
}
