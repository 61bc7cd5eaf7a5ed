//! Unit tests of `groups`.

use super::*;

#[test]
fn names_with_the_same_readers_share_a_group() {
    let mut groups = Groups::default();
    assert_eq!(groups.take(&[]), (NEIGHBOURS, false));
    assert_eq!(groups.take(&[7, 9]), (1, true));
    assert_eq!(groups.take(&[7]), (2, true));
    assert_eq!(groups.take(&[7, 9]), (1, false));
    assert_eq!(groups.readers(1), [7, 9]);
    assert!(!groups.release(1) && groups.release(1), "the second name was the last");
    assert_eq!((groups.readers(1), groups.readers(2)), (&[][..], &[7][..]));
    assert_eq!(groups.take(&[8]), (1, true), "a free number is used again");
    assert_eq!(groups.take(&[9]), (3, true));
    assert!(!groups.release(NEIGHBOURS) && !groups.release(99), "not ours to free");
    assert_eq!(groups.iter().count(), 3);
}

#[test]
fn only_where_a_frame_has_two_ways_to_go_are_copies_made() {
    let mut groups = Groups::default();
    let (one, two) = (groups.take(&[7]).0, groups.take(&[7, 9]).0);
    assert!([(NEIGHBOURS, 2), (one, 1), (one, 0), (two, 0)].iter().all(|(group, n)| !groups.makes_copies(*group, *n)));
    assert!([(NEIGHBOURS, 3), (one, 2), (two, 1)].iter().all(|(group, n)| groups.makes_copies(*group, *n)));
    assert!(groups.fork(two) && !groups.fork(two) && groups.fork(NEIGHBOURS) && !groups.fork(99));
    assert!(groups.makes_copies(two, 0) && groups.makes_copies(NEIGHBOURS, 2) && !groups.makes_copies(one, 1));
    groups.release(two);
    let another = groups.take(&[3, 4]).0;
    assert!(!groups.makes_copies(another, 0));
}

#[test]
fn a_group_may_keep_the_number_it_had() {
    let mut groups = Groups::default();
    assert_eq!(groups.take_as(&[7], Some(4)), (4, true));
    assert_eq!(groups.take_as(&[7], Some(2)), (4, false), "it has one");
    assert_eq!(groups.take_as(&[8], Some(4)), (1, true), "another's");
    assert_eq!(groups.take_as(&[9], Some(NEIGHBOURS)), (2, true));
    assert_eq!((groups.take(&[10]), groups.take(&[11])), ((3, true), (5, true)));
}
