//! Unit tests of `port::linux::discover`.

use super::*;

#[test]
fn answers_are_limited_and_only_given_by_switches() {
    assert_eq!(Discovery::new(None).answer(), None);
    let name = Name::from_bytes([7; 32]);
    let switch = Discovery::new(Some(name));
    let answered = (0..1000).filter(|_| switch.answer() == Some(name)).count();
    assert!((ANSWERS as usize..=2 * ANSWERS as usize).contains(&answered), "{answered}");
}
