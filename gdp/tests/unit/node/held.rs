//! Unit tests of `node::held`.

use super::*;

const WHY: (DropReason, u64) = (DropReason::NoKey, 1);

#[test]
fn frames_are_released_in_order_and_only_for_their_name_and_source() {
    let (name, other) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]));
    let mut held = Held::default();
    for i in 0..4 {
        for (name, source, byte) in [(name, name, i), (other, name, 9), (name, other, 9)] {
            assert!(held.hold((name, source), &[byte], false, WHY));
        }
    }
    let released = held.release(&name, &name);
    assert_eq!(released.iter().map(|frame| frame.payload[0]).collect::<Vec<_>>(), [0, 1, 2, 3]);
    assert_eq!((held.frames.len(), held.bytes), (8, 8 * (OVERHEAD + 1)));
    released.into_iter().rev().for_each(|frame| held.hold_again(frame, WHY));
    assert!(held.frames.iter().is_sorted_by_key(|frame| frame.since));
    let again = held.release(&name, &name);
    assert_eq!(again.iter().map(|frame| frame.payload[0]).collect::<Vec<_>>(), [0, 1, 2, 3]);
    assert_eq!(held.release(&name, &other).len() + held.release(&other, &name).len(), 8);
    assert_eq!((held.frames.len(), held.bytes), (0, 0));
}

#[test]
fn memory_is_bounded_and_what_finds_no_room_is_not_held() {
    let mut held = Held::default();
    let most = MAX_BYTES / OVERHEAD;
    let taken = (0..100_000).filter(|_| held.hold((Name::default(), Name::default()), &[], false, WHY)).count();
    assert_eq!(taken, most);
    assert_eq!((held.frames.len(), held.bytes), (most, most * OVERHEAD));
    assert_eq!(held.next_expired(), None, "nothing waited for long");
}
