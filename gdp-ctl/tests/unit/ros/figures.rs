//! Unit tests of `ros::figures`.

use super::*;

#[test]
fn intervals_are_of_the_last_messages_and_told_once() {
    let mut intervals = Intervals::new(2);
    intervals.record(0);
    assert_eq!(intervals.spread(), None);
    for now in [50_000_000, 150_000_000, 350_000_000] {
        intervals.record(now);
    }
    let spread = intervals.spread().unwrap();
    assert_eq!((spread.mean, spread.count), (150_000_000.0, 2));
    assert_eq!(spread.text(), "\tmin: 0.100s max: 0.200s std dev: 0.05000s window: 2");
    assert_eq!(intervals.spread(), None, "nothing is new");
}

#[test]
fn ages_may_be_less_than_nothing() {
    let mut delays = Delays::new(10);
    delays.record(-2_000_000);
    delays.record(4_000_000);
    let spread = delays.spread().unwrap();
    assert_eq!((spread.mean, spread.min, spread.max), (1_000_000.0, -2_000_000, 4_000_000));
}

#[test]
fn bandwidth_has_one_unit() {
    let mut sizes = Sizes::new(3);
    sizes.record(0, 99);
    assert_eq!(sizes.bandwidth(1), None, "of one message");
    for (now, bytes) in [(0, 200), (500_000_000, 400), (1_000_000_000, 600)] {
        sizes.record(now, bytes);
    }
    let text = sizes.bandwidth(1_000_000_000).unwrap().text();
    assert_eq!(text, "1.20 KB/s from 3 messages\n\tMessage size mean: 0.40 KB min: 0.20 KB max: 0.60 KB");
    let text = sizes.bandwidth(10_000_000_000).unwrap().text();
    assert_eq!(text, "120 B/s from 3 messages\n\tMessage size mean: 400 B min: 200 B max: 600 B");
}
