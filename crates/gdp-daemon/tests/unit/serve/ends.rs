//! Unit tests of `serve::ends`.

use super::*;

#[test]
fn a_new_link_is_sent_on_once_the_peer_takes_frames_there() {
    let mut ends = Ends::default();
    ends.up(0, 1);
    assert_eq!(ends.out(), Some(1), "there is no better one");
    ends.ready(1);
    ends.up(0, 2);
    assert_eq!((ends.out(), ends.all().collect::<Vec<_>>()), (Some(1), vec![1, 2]));
    ends.up(0, 3);
    assert_eq!((ends.out(), ends.all().collect::<Vec<_>>()), (Some(1), vec![1, 3]), "2 was never in use");
    ends.ready(2);
    assert_eq!(ends.out(), Some(1));
    ends.ready(3);
    assert_eq!(ends.out(), Some(3));
    assert!(ends.is_earlier(1) && !ends.is_earlier(3));
    assert!(ends.removed(1).is_empty());
    assert_eq!(ends.all().collect::<Vec<_>>(), [3]);
}

#[test]
fn a_silent_link_stays_and_one_that_is_ended_takes_earlier_ones_along() {
    let mut ends = Ends::default();
    ends.adopt(0, 1);
    ends.up(0, 2);
    assert!(!ends.silent(2), "1 is still the better one");
    assert!(ends.removed(2).is_empty(), "and stays");
    ends.up(0, 3);
    ends.ready(3);
    assert!(ends.silent(3));
    assert_eq!(ends.out(), Some(3));
    ends.up(0, 4);
    ends.ready(4);
    assert_eq!(ends.removed(4), [1, 3]);
    assert!(ends.is_empty());
}

#[test]
fn lanes_are_sent_on_beside_each_other_and_one_is_preferred() {
    let mut ends = Ends::default();
    ends.up(0, 1);
    ends.ready(1);
    ends.up(2, 3);
    ends.ready(3);
    assert_eq!((ends.out(), ends.each().collect::<Vec<_>>()), (Some(1), vec![1, 3]));
    assert!(!ends.is_earlier(1), "3 replaces nothing");
    ends.prefer(3);
    assert_eq!(ends.out(), Some(3));
    ends.prefer(9);
    assert_eq!(ends.out(), Some(3), "there is no such link");
    assert!(ends.silent(3));
    assert_eq!((ends.out(), ends.each().collect::<Vec<_>>()), (Some(1), vec![1, 3]), "it is held, but not preferred");
    assert!(ends.removed(3).is_empty());
    ends.up(2, 4);
    ends.ready(4);
    assert_eq!(ends.out(), Some(4), "the lane is still the one");
    assert!(ends.removed(1).is_empty());
    assert_eq!(ends.all().collect::<Vec<_>>(), [4]);
}
