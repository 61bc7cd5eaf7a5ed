//! Unit tests of `suspicion`.

use super::*;

#[test]
fn a_burst_is_reported_once_a_minute_with_all_of_it() {
    let (mut bursts, start) = (Bursts::default(), Instant::now());
    let mut take = |seconds, value| bursts.take("frames", value, 10, start + Duration::from_secs(seconds));
    assert_eq!(take(0, 500), None, "an earlier daemon counted these");
    assert_eq!(take(5, 509), None);
    assert_eq!(take(10, 512), Some(12));
    assert_eq!((take(15, 900), take(65, 1000)), (None, None));
    assert_eq!(take(70, 1000), Some(488));
}

#[test]
fn a_few_now_and_then_are_none() {
    let (mut bursts, start) = (Bursts::default(), Instant::now());
    for minute in 0..10 {
        assert_eq!(bursts.take("frames", 9 * minute, 10, start + PERIOD * minute as u32), None);
    }
}
