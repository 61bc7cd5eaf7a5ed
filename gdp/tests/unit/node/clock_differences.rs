//! Unit tests of `clock_differences`.

use super::*;

const HOUR: i64 = 3600 * 1_000_000_000;

#[test]
fn a_difference_is_shown_for_a_minute_after_it_was_last_stated() {
    let (clocks, start, peer) = (ClockDifferences::default(), Instant::now(), name(1));
    let seconds = |seconds| start + Duration::from_secs(seconds);
    clocks.record(start, peer, -HOUR, false);
    clocks.record(seconds(50), peer, -HOUR, false);
    let expected = ClockDifference { peer, ahead_ms: -3_600_000, refuses: false };
    assert_eq!((clocks.all(seconds(109)), clocks.all(seconds(110))), (vec![expected], vec![]));
    clocks.record(seconds(120), peer, HOUR, true);
    let text = clocks.all(seconds(120))[0].to_string();
    assert!(text.contains("its clock is 3600 s ahead of the one here"), "{text}");
    assert!(text.contains(&format!("{peer:#} refuses")), "{text}");
    clocks.record(seconds(121), peer, 4_900_000_000, true);
    assert_eq!(clocks.all(seconds(121)), vec![], "a message was late");
    clocks.record(seconds(122), peer, HOUR, false);
    assert_eq!(clocks.all(seconds(122)), vec![], "a message of a clock that is ahead is not too old for that");
}

#[test]
fn extreme_times_and_many_peers_are_bounded() {
    let (clocks, start) = (ClockDifferences::default(), Instant::now());
    for i in 0..MAX_PEERS as u64 + 10 {
        let ahead_ns = if i % 2 == 0 { i64::MIN } else { i64::MAX };
        clocks.record(start + Duration::from_millis(i), name(i), ahead_ns, ahead_ns > 0);
    }
    let all = clocks.all(start + Duration::from_secs(1));
    assert_eq!(all.len(), MAX_PEERS);
    assert!(all.iter().all(|difference| difference.peer != name(0)), "the oldest made room");
    all.iter().for_each(|difference| assert!(difference.to_string().contains("9223372036 s")));
}

fn name(i: u64) -> Name {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&i.to_be_bytes());
    Name::from_bytes(bytes)
}
