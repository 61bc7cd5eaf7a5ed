//! Unit tests of `rib::bits`.

use super::*;

#[test]
fn bits_are_stable_and_run_out_with_an_error() {
    let mut bits = Bits::default();
    for i in 0..64 {
        bits.give(name(i), None, free).unwrap();
        assert_eq!(bits.of(&name(i)), Some(i));
    }
    assert_eq!(bits.give(name(64), None, free), Err(Full));
    assert_eq!(bits.exchange(name(3), free), Err(Full));
    bits.give(name(5), Some(9), free).unwrap();
    assert_eq!((bits.of(&name(5)), bits.of(&name(3))), (Some(5), Some(3)));
    bits.forget(&name(7));
    bits.give(name(64), None, free).unwrap();
    assert_eq!((bits.of(&name(64)), bits.of(&name(7))), (Some(7), None));
}

#[test]
fn a_switch_gets_the_bit_it_had_if_that_is_free() {
    let mut bits = Bits::default();
    for (i, had, gets) in [(1, Some(7), 7), (2, None, 0), (3, Some(7), 1), (4, Some(64), 2), (1, Some(9), 7)] {
        bits.give(name(i), had, free).unwrap();
        assert_eq!(bits.of(&name(i)), Some(gets));
    }
}

#[test]
fn what_others_have_is_given_last() {
    let mut bits = Bits::default();
    let taken = |bit| bit != 9;
    for (i, had, gets) in [(1, None, 9), (2, Some(4), 4), (3, None, 0)] {
        bits.give(name(i), had, taken).unwrap();
        assert_eq!(bits.of(&name(i)), Some(gets));
    }
    bits.exchange(name(1), |bit| bit < 20).unwrap();
    assert_eq!(bits.of(&name(1)), Some(20));
    bits.give(name(4), Some(9), taken).unwrap();
    assert_eq!(bits.of(&name(4)), Some(9), "it is free again");
}

fn free(_: u8) -> bool {
    false
}

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}
