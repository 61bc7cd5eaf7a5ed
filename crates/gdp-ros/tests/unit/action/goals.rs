//! Unit tests of `action::goals`.

use std::time::Duration;

use super::*;

fn id(number: usize) -> GoalId {
    (number as u128).to_be_bytes()
}

#[test]
fn a_goal_is_remembered_until_it_has_ended_for_a_while() {
    let (mut goals, start) = (Goals::default(), Instant::now());
    goals.begin(id(1), 'a').unwrap();
    goals.begin(id(2), 'b').unwrap();
    assert_eq!((goals.get(&id(1)), goals.has_live('a'), goals.get(&id(3))), (Some('a'), true, None));
    goals.end(start, &id(1));
    goals.end(start + LINGER, &id(1));
    assert!(!goals.has_live('a') && goals.has_live('b'));
    goals.sweep(start + LINGER - Duration::from_secs(1));
    assert_eq!(goals.get(&id(1)), Some('a'));
    goals.sweep(start + LINGER);
    assert_eq!((goals.get(&id(1)), goals.get(&id(2))), (None, Some('b')));
    goals.end_all(start, 'b');
    goals.sweep(start + LINGER);
    assert_eq!(goals.get(&id(2)), None);
}

#[test]
fn nobody_takes_anothers_goal() {
    let mut goals = Goals::default();
    goals.begin(id(1), 'a').unwrap();
    assert_eq!((goals.begin(id(1), 'b'), goals.begin(id(1), 'a')), (Err(GoalsError::Taken), Ok(())));
    goals.forget(&id(1));
    assert_eq!(goals.begin(id(1), 'b'), Ok(()));
}

#[test]
fn those_that_have_ended_give_way_and_others_do_not() {
    let (mut goals, start) = (Goals::default(), Instant::now());
    (0..MAX_GOALS).for_each(|number| goals.begin(id(number), 'a').unwrap());
    assert_eq!(goals.begin(id(MAX_GOALS), 'a'), Err(GoalsError::Full));
    goals.end(start + Duration::from_secs(1), &id(4));
    goals.end(start, &id(7));
    goals.begin(id(MAX_GOALS), 'a').unwrap();
    assert_eq!((goals.get(&id(7)), goals.get(&id(4)), goals.goals.len()), (None, Some('a'), MAX_GOALS));
}
