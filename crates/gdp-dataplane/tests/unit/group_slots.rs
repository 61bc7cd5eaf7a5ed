//! Unit tests of `group_slots`.

use super::*;

#[test]
fn a_link_keeps_its_place_while_others_come_and_go() {
    let member = |link, interface| Member { link, interface };
    let mut places = GroupSlots::default();
    let steps = places.become_these(&[member(10, 3), member(11, 3), member(12, 3), member(20, 4)], 8).unwrap();
    assert_eq!(steps.len(), 8);
    assert_eq!(steps[..2], [Step::Occupy { interface: 3, index: 0, link: 10 }, Step::AddKey { key: 0, interface: 3 }]);
    let steps = places.become_these(&[member(12, 3), member(20, 4)], 8).unwrap();
    assert_eq!(steps, [Step::Vacate { interface: 3, index: 0 }, Step::Vacate { interface: 3, index: 1 }]);
    let steps = places.become_these(&[member(12, 3), member(13, 3), member(20, 4)], 8).unwrap();
    assert_eq!(steps, [Step::Occupy { interface: 3, index: 0, link: 13 }]);
    let steps = places.become_these(&[member(13, 3), member(20, 4)], 8).unwrap();
    assert_eq!(
        steps,
        [Step::Vacate { interface: 3, index: 2 }, Step::RemoveKey { key: 2 }, Step::RemoveKey { key: 1 }]
    );
    assert_eq!(places.become_these(&[], 8).unwrap().len(), 4);
    assert_eq!(places, GroupSlots::default());
}

#[test]
fn empty_places_take_room() {
    let many = |range: std::ops::Range<u32>| range.map(|link| Member { link, interface: 3 }).collect::<Vec<_>>();
    let mut places = GroupSlots::default();
    assert!(places.become_these(&many(1..6), 4).is_none());
    places.become_these(&many(1..5), 4).unwrap();
    places.become_these(&many(4..5), 4).unwrap();
    let before = places.clone();
    assert!(places.become_these(&[&many(4..5)[..], &[Member { link: 9, interface: 5 }]].concat(), 4).is_none());
    assert_eq!(places, before);
}

#[test]
fn what_is_found_is_the_same_group() {
    let mut places = GroupSlots::default();
    let members = [(10, 3), (11, 3), (20, 4)].map(|(link, interface)| Member { link, interface });
    places.become_these(&members, 8).unwrap();
    let mut found = GroupSlots::found(&[(0, 3), (1, 3), (2, 4)], &[(3, 0, 10), (4, 0, 20), (3, 1, 11)]).unwrap();
    assert_eq!(found, places);
    assert_eq!(found.become_these(&members, 8), Some(vec![]));
    assert_eq!(GroupSlots::found(&[(0, 3)], &[(3, 0, 10), (3, 1, 11)]), None, "a place without a key");
}
