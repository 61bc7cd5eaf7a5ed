//! Unit tests of `node::choice`.

use super::Fitness::{Doubtful, Down, Up};
use super::*;

#[test]
fn what_is_lost_is_left_at_once_and_returned_to_once_it_is_stable() {
    let mut choice = Choice::default();
    let mut look = |now, lanes: [Fitness; 3]| {
        choice.look(now, &lanes);
        (choice.main(), choice.second())
    };
    assert_eq!(look(0, [Down, Up, Down]), (1, None), "the first that is up");
    assert_eq!(look(1, [Up, Up, Up]), (1, Some(0)));
    assert_eq!(look(STABLE, [Up, Up, Up]), (1, Some(0)), "not yet");
    assert_eq!(look(STABLE + 1, [Up, Up, Up]), (0, Some(1)));
    assert_eq!(look(STABLE + 2, [Doubtful, Up, Up]), (1, Some(2)));
    assert_eq!(look(STABLE + 3, [Up, Up, Up]), (1, Some(0)));
    assert_eq!(look(2 * STABLE, [Doubtful, Up, Up]), (1, Some(2)), "it comes and goes");
    assert_eq!(look(2 * STABLE + 1, [Up, Up, Up]), (1, Some(0)));
    assert_eq!(look(3 * STABLE, [Up, Up, Up]), (1, Some(0)), "so it waits anew");
    assert_eq!(look(3 * STABLE + 1, [Up, Up, Up]), (0, Some(1)));
}

#[test]
fn a_doubtful_link_is_better_than_none() {
    let mut choice = Choice::default();
    let mut look = |lanes: [Fitness; 2]| {
        choice.look(0, &lanes);
        (choice.main(), choice.second())
    };
    assert_eq!(look([Up, Up]), (0, Some(1)));
    assert_eq!(look([Doubtful, Doubtful]), (0, None), "it stays where it is");
    assert_eq!(look([Down, Doubtful]), (1, None));
    assert_eq!(look([Down, Down]), (1, None));
    assert_eq!(look([Doubtful, Down]), (0, None));
}

#[test]
fn nothing_changes_without_reason() {
    let mut choice = Choice::default();
    assert!(choice.look(0, &[Up, Up]), "a second");
    assert!(!choice.look(1, &[Up, Up]));
    assert!(!choice.look(9 * STABLE, &[Up, Up]));
    assert!(choice.look(9 * STABLE, &[Up, Down]));
}
