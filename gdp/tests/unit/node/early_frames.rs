//! Unit tests of `node::early_frames`.

use super::*;

const WHY: (DropReason, u64) = (DropReason::NoKey, 1);

#[test]
fn frames_are_released_in_order_and_only_for_their_name_and_source() {
    let (name, other) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]));
    let mut early = EarlyFrames::default();
    for i in 0..4 {
        for (name, source, byte) in [(name, name, i), (other, name, 9), (name, other, 9)] {
            assert!(early.keep((name, source), &[byte], false, WHY));
        }
    }
    let released = early.release(&name, &name);
    assert_eq!(released.iter().map(|frame| frame.payload[0]).collect::<Vec<_>>(), [0, 1, 2, 3]);
    assert_eq!((early.frames.len(), early.bytes), (8, 8 * (OVERHEAD + 1)));
    released.into_iter().rev().for_each(|frame| early.keep_again(frame, WHY));
    assert!(early.frames.iter().is_sorted_by_key(|frame| frame.since));
    let again = early.release(&name, &name);
    assert_eq!(again.iter().map(|frame| frame.payload[0]).collect::<Vec<_>>(), [0, 1, 2, 3]);
    assert_eq!(early.release(&name, &other).len() + early.release(&other, &name).len(), 8);
    assert_eq!((early.frames.len(), early.bytes), (0, 0));
}

#[test]
fn memory_is_bounded_and_what_finds_no_room_is_not_held() {
    let mut early = EarlyFrames::default();
    let most = MAX_BYTES / OVERHEAD;
    let taken = (0..100_000).filter(|_| early.keep((Name::default(), Name::default()), &[], false, WHY)).count();
    assert_eq!(taken, most);
    assert_eq!((early.frames.len(), early.bytes), (most, most * OVERHEAD));
    assert_eq!(early.next_expired(), None, "nothing waited for long");
}
