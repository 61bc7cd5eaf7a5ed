//! Unit tests of `serve::liveness`.

use super::*;

#[test]
fn echoes_are_no_data_and_forgeries_no_sign_of_life() {
    let mut arrivals = [0; Counter::COUNT];
    let before = traffic(&arrivals, 100, 0);
    // The peer's 5 echoes and the answers to 3 own ones.
    (arrivals[Counter::Echoed as usize], arrivals[Counter::Notice as usize]) = (5, 3);
    let after = traffic(&arrivals, 100 + 5 + 3, 3);
    assert_eq!((after.0 - before.0, after.1 - before.1), (8, 0));
    for forged in [Counter::BadTag, Counter::Replayed, Counter::NoLink, Counter::Slow] {
        arrivals[forged as usize] = 1000;
        assert_eq!(traffic(&arrivals, 108, 3), after, "{forged:?}");
    }
    arrivals[Counter::Forwarded as usize] = 7;
    let received = traffic(&arrivals, 108, 3);
    assert_eq!((received.0 - after.0, received.1 - after.1), (7, 7));
    assert_eq!(traffic(&arrivals, 110, 3).1 - received.1, 2, "data that was sent");
}
