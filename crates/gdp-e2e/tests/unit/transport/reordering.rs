//! Unit tests of `transport::reordering`.

use super::*;

const RTT: u64 = MS;

fn position(index: u32) -> Position {
    Position { sequence: 1, index }
}

#[test]
fn only_a_needless_request_widens_the_window_and_only_for_a_time() {
    let mut window = ReorderingWindow::default();
    window.on_duplicate(10 * MS, position(1), RTT);
    assert_eq!(window.tolerance(RTT), LEAST_TOLERANCE, "a cable may double frames");

    window.on_answer(position(1));
    window.on_duplicate(20 * MS, position(1), RTT);
    assert_eq!(window.tolerance(RTT), 2 * LEAST_TOLERANCE);
    window.on_duplicate(21 * MS, position(1), RTT);
    assert_eq!(window.tolerance(RTT), 2 * LEAST_TOLERANCE, "of the same cause");

    for i in 0..100 {
        window.on_answer(position(i));
        window.on_duplicate(1_000 * MS + u64::from(i) * 100 * MS, position(i), RTT);
    }
    assert_eq!(window.tolerance(RTT), MOST_TOLERANCE);
    assert_eq!(window.tolerance(8_000 * MS), 1_000 * MS, "a long path has its own tolerance");

    let mut now = 11_000 * MS;
    while window.extra() > 0 {
        now += NEEDLESS_FOR;
        window.look(now);
        assert!(now < 60_000 * MS);
    }
}
