//! Unit tests of `link::liveness`.

use super::*;

const MISSES: usize = Pace::ETHERNET.misses;
const NONE: u64 = 0;

#[test]
fn a_neighbour_that_answers_lives_as_long_as_it_does() {
    let mut liveness = Liveness::new(Pace::ETHERNET);
    assert!((1..1000).all(|cookie| liveness.step(cookie - 1, cookie) == Step::Ask));
    // No further answers arrive; 999 is answered.
    let asked = (0..MISSES as u64).take_while(|n| liveness.step(999, 2000 + n) == Step::Ask).count();
    assert_eq!(asked, MISSES);
    assert_eq!(liveness.step(999, 3000), Step::Silent);
    assert_eq!(liveness.step(NONE, 3001), Step::Silent, "for good");
}

#[test]
fn one_that_never_answers_is_gone_after_so_many_echoes() {
    for pace in [Pace::ETHERNET, Pace::UDP] {
        let mut liveness = Liveness::new(pace);
        let asked = (1..100).take_while(|cookie| liveness.step(NONE, *cookie) == Step::Ask).count();
        assert_eq!(asked, pace.misses);
    }
}

#[test]
fn losses_between_answers_are_no_silence() {
    let mut liveness = Liveness::new(Pace::UDP);
    let mut answer = NONE;
    for cookie in 1..1000 {
        assert_eq!(liveness.step(answer, cookie), Step::Ask, "{cookie}");
        if cookie % Pace::UDP.misses as u64 == 0 {
            answer = cookie;
        }
    }
}

#[test]
fn an_answer_settles_the_echoes_up_to_its_own() {
    let mut liveness = Liveness::new(Pace::ETHERNET);
    (1..=4).for_each(|cookie| assert_eq!(liveness.step(NONE, cookie), Step::Ask));
    // The late answer to 2 leaves 3 and 4 open.
    assert_eq!(liveness.step(2, 5), Step::Ask);
    assert_eq!(liveness.open.open, [3, 4, 5]);
    assert_eq!(liveness.step(1, 6), Step::Ask, "an older one says nothing new");
    assert_eq!(liveness.open.open, [3, 4, 5, 6]);
}

#[test]
fn an_answer_to_nothing_that_is_open_is_no_sign_of_life() {
    let mut liveness = Liveness::new(Pace::ETHERNET);
    assert_eq!(liveness.step(NONE, 1), Step::Ask);
    // Only the answer to the first echo, repeatedly.
    let asked = (2..100).take_while(|cookie| liveness.step(1, *cookie) == Step::Ask).count();
    assert_eq!(asked, MISSES);
    let mut liveness = Liveness::new(Pace::ETHERNET);
    let asked = (1..100).take_while(|cookie| liveness.step(cookie + 1000, *cookie) == Step::Ask).count();
    assert_eq!(asked, MISSES, "made up");
}
