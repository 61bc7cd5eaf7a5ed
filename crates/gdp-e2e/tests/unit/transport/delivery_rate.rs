use super::*;
use crate::transport::Position;

fn sent(at: u64, pauses: u64) -> Sent {
    Sent { position: Position { sequence: 1, index: 0 }, at, total: 0, pauses }
}

#[test]
fn reports_that_are_processed_together_make_no_higher_rate() {
    let mut rate = DeliveryRate::new(0);
    let step = MS / 10;
    for at in (step..10 * MS).step_by(step as usize) {
        let sample = rate.add(at, step, &sent(at - step, 0));
        assert_eq!(sample.bytes, sample.interval, "{at}");
    }
    // The thread is away for 5 ms, and then processes 50 reports at once, of frames that it had
    // sent in a burst.
    for at in (10 * MS..15 * MS).step_by(step as usize) {
        let sample = rate.add(15 * MS, step, &sent(10 * MS, 0));
        assert!(sample.bytes <= sample.interval, "{at}: {sample:?}");
    }
    for at in (15 * MS..20 * MS).step_by(step as usize) {
        let sample = rate.add(at + step, step, &sent(at, 0));
        assert!(sample.bytes <= sample.interval + step, "{at}: {sample:?}");
    }
}

#[test]
fn a_pause_ends_a_sample_and_memory_is_bounded() {
    let mut rate = DeliveryRate::new(0);
    assert!(!rate.add(MS, 1, &sent(0, 1)).paused);
    assert!(rate.add(100 * MS, 1, &sent(99 * MS, 2)).paused);
    // What was sent after the pause is a sample as soon as it is long enough.
    assert!(rate.add(100 * MS + MS / 2, 1, &sent(99 * MS + MS / 2, 2)).paused);
    let sample = rate.add(101 * MS, 7, &sent(100 * MS, 2));
    assert_eq!(sample, RateSample { bytes: 8, interval: MS, paused: false });
    for at in 0..10_000 {
        rate.add(102 * MS + at, 1, &sent(101 * MS, 2));
    }
    assert!(rate.reports.len() <= MOST);
}
