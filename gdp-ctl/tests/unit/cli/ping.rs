//! Unit tests of `cli::ping`.

use super::*;

#[test]
fn what_came_back_is_summed_up() {
    let mut tally = Tally::default();
    assert_eq!((tally.loss(), tally.times()), (0.0, None));
    [Some(1500), None, Some(500), Some(1000)].into_iter().for_each(|rtt| tally.add(rtt));
    let text = tally.lines(&Name::from_bytes([7; 32])).join("\n");
    assert!(text.contains("4 sent, 3 received, 25% loss"), "{text}");
    assert!(text.contains("rtt min/avg/max = 0.500/1.000/1.500 ms"), "{text}");
}

#[test]
fn intervals_have_bounds() {
    assert_eq!(parse_interval("0.2"), Ok(0.2));
    for text in ["0", "-1", "NaN", "inf", "0.001", "fast"] {
        assert!(parse_interval(text).is_err(), "{text}");
    }
}
