//! Unit tests of `seal::plan`.

use super::*;
use crate::seal::Encoding;
use wire::{MAX_PLAINTEXT, MIN_PAYLOAD};

#[test]
fn messages_are_cut_into_the_fewest_segments() {
    let cut = |len: usize, max| {
        let (capacity, room) = Cut::room(max, 0).unwrap();
        Cut::new(len - 12, 12, capacity, room)
    };
    let capacity = 1000 - OVERHEAD;
    let room = capacity - 68;
    let size = |count, size: usize| Ok(Cut { count, size: size as u32 });
    assert_eq!(cut(12, 1000), size(1, 12));
    assert_eq!(cut(room, 1000), size(1, room));
    // The proof does not fit beside the end of the message: it is behind it.
    assert_eq!(cut(room + 1, 1000), size(2, room + 1));
    assert_eq!(cut(capacity, 1000), size(2, capacity));
    assert_eq!(cut(capacity + room, 1000), size(2, capacity));
    assert_eq!(cut(capacity + room + 1, 1000), size(3, capacity));
    assert_eq!(cut(10 * capacity, 1000), size(11, capacity));
    assert_eq!(cut(100, MIN_PAYLOAD), size(3, 68));
    assert_eq!(cut(1 << 20, usize::MAX), size(17, MAX_PLAINTEXT));
}

#[test]
fn what_cannot_be_cut_is_refused() {
    let room = |max, depth| Cut::room(max, depth);
    let small = |max_payload, need| Err(SealError::PayloadTooSmall { max_payload, need });
    assert_eq!(room(MIN_PAYLOAD - 1, 0), small(127, 128));
    assert_eq!(room(0, 0), small(0, 128));
    assert_eq!(room(200, 16), small(200, 640));
    assert!(matches!(Cut::new(usize::MAX, 16, 1000, 900), Err(SealError::MessageTooLarge { .. })));
    let most = (u32::MAX as usize - 1) * 68;
    assert_eq!(Cut::new(most - 16, 16, 68, 0), Ok(Cut { count: u32::MAX, size: 68 }));
    assert!(matches!(Cut::new(most - 15, 16, 68, 0), Err(SealError::MessageTooLarge { .. })));
    let draft = Draft { origin: &[0; 65], ..Draft::new(Encoding::Bytes, b"") };
    assert_eq!(plan(&[draft], 1000, &mut Vec::new()), Err(SealError::OriginTooLong(65)));
}

#[test]
fn small_messages_share_bundles_and_others_are_alone() {
    let (small, large, huge) = (&[0; 64][..], &[0; 1150][..], &[0; 70_000][..]);
    let planned = |bodies: &[&[u8]]| {
        let drafts: Vec<_> = bodies.iter().map(|body| Draft::new(Encoding::Cdr, body)).collect();
        let mut units = Vec::new();
        plan(&drafts, 1400, &mut units).unwrap();
        units.iter().map(|unit| (unit.messages, unit.segments, unit.size)).collect::<Vec<_>>()
    };
    assert_eq!(planned(&[small]), [(1, 1, 12 + 64)]);
    assert_eq!(planned(&[small; 2]), [(2, 1, 8 + 2 * 70)]);
    // 1340 − 68 − 8 bytes are room for 18 of them.
    assert_eq!(planned(&[small; 18]), [(18, 1, 8 + 18 * 70)]);
    // With a second bundle the proofs have one hash more.
    assert_eq!(planned(&[small; 19]), [(17, 1, 8 + 17 * 70), (2, 1, 8 + 2 * 70)]);
    assert_eq!(
        planned(&[large, small, small, huge, small]),
        [(1, 1, 12 + 1150), (2, 1, 8 + 2 * 70), (1, 53, 1340), (1, 1, 12 + 64)]
    );
    // Room for a longer proof is given back when it turns out to be shorter.
    assert_eq!(planned(&[&[][..]; 200]), [(200, 1, 8 + 200 * 6)]);
}
