//! Unit tests of `transport::black_hole`.

use super::*;

#[test]
fn only_what_is_asked_for_in_vain_again_and_again_is_suspicious() {
    let mut suspicion = Suspicion::default();
    let mut ask = |at: u64, sequences: &[u64], rtt: u64| {
        let missing: Vec<_> = sequences.iter().map(|sequence| Missing::whole(*sequence)).collect();
        suspicion.asked(at * MS, &missing, (at * MS).saturating_sub(rtt * MS))
    };
    assert!((0..100).all(|at| !ask(at, &[at], 0)), "always another");
    assert!((4000..4019).all(|at| !ask(at, &[1000], 20)), "within a round trip");
    // The request is one of several, and not in every Nack.
    let found = (4020..4060).map(|at| ask(at, if at % 2 == 0 { &[1000, 1001] } else { &[1002] }, 5));
    assert_eq!(found.filter(|found| *found).count(), 1);

    let mut suspicion = Suspicion::default();
    for at in 0..100 {
        assert!(!suspicion.asked(at, &[Missing::whole(1)], at));
        if at % 3 == 0 {
            suspicion.on_received(LEAST_PAYLOAD + 1);
        }
        suspicion.on_received(LEAST_PAYLOAD);
    }
}

#[test]
fn large_frames_are_tried_again_and_less_and_less_often() {
    let (mut limit, mut now, mut times) = (FrameLimit::default(), 5, Vec::new());
    assert_eq!(limit.max_payload(now), usize::MAX);
    for _ in 0..7 {
        limit.set(now);
        limit.set(now + 1);
        let until = limit.until;
        assert_eq!((limit.max_payload(until - 1), limit.max_payload(until)), (LEAST_PAYLOAD, usize::MAX));
        times.push((until - now) / (1000 * MS));
        now = until;
    }
    assert_eq!(times, [30, 60, 120, 240, 480, 600, 600]);
}
