//! Unit tests of `timing`.

use super::*;

#[test]
fn percentiles_are_of_the_latest() {
    let timing = Timing::default();
    assert_eq!(timing.percentiles(), None);
    (0..LATEST).for_each(|_| timing.record(Duration::from_secs(1)));
    (1..=LATEST as u64).for_each(|i| timing.record(Duration::from_micros(i)));
    assert_eq!(timing.percentiles(), Some(Percentiles { p50: 513, p99: 1014 }));
    timing.record(Duration::MAX);
    timing.record_since(u64::MAX);
}
