//! Unit tests of `line_limit`.

use super::*;

#[test]
fn a_period_has_a_few_lines_and_the_next_one_counts_the_rest() {
    let (limit, start) = (LineLimit::new(2, Duration::from_secs(60)), Instant::now());
    let at = |seconds| start + Duration::from_secs(seconds);
    assert_eq!([0, 1, 2, 59].map(|seconds| limit.take(at(seconds))), [Some(0), Some(0), None, None]);
    assert_eq!([60, 61, 62].map(|seconds| limit.take(at(seconds))), [Some(2), Some(0), None]);
    assert_eq!(limit.take(at(500)), Some(1));
}
