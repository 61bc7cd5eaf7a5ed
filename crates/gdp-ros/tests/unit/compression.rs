//! Unit tests of `compression`.

use super::*;
use crate::{call::CALL, catalog::CATALOG, roster::ROSTER};

#[test]
fn bodies_become_shorter_and_are_as_before_again() {
    let mut packer = Packer::new().unwrap();
    let body: Vec<u8> = (0..100_000u32).map(|i| (i / 100) as u8).collect();
    for (encoding, number) in [(Encoding::Json, 0x8001), (Encoding::Cdr, 0x8002), (Encoding::Ros1, 0x8003)] {
        let (packed_in, packed) = packer.pack(encoding, &body);
        assert_eq!(u16::from(packed_in), number);
        assert!(packed.len() < body.len() / 10, "{}", packed.len());
        let packed = Bytes::copy_from_slice(packed);
        assert_eq!(unpacked(packed_in, packed).unwrap(), (encoding, body.clone().into()));
    }
}

#[test]
fn what_would_not_become_shorter_goes_as_it_is() {
    let mut packer = Packer::new().unwrap();
    let noise = noise(10_000);
    for body in [&noise[..], &[7; WORTHWHILE - 1], &[]] {
        assert_eq!(packer.pack(Encoding::Cdr, body), (Encoding::Cdr, body));
    }
    assert_ne!(packer.pack(Encoding::Cdr, &[7; WORTHWHILE]).0, Encoding::Cdr);
}

#[test]
fn other_encodings_are_left_alone() {
    let mut packer = Packer::new().unwrap();
    for encoding in [Encoding::Bytes, ROSTER, CATALOG, CALL, Encoding::Other(0x8000), Encoding::Other(0x8004)] {
        assert_eq!(packer.pack(encoding, &[7; 1000]).0, encoding);
        let body = Bytes::from_static(b"as it is");
        assert_eq!(unpacked(encoding, body.clone()).unwrap(), (encoding, body));
    }
}

#[test]
fn no_more_memory_is_taken_than_for_the_largest_message() {
    let most = ReaderLimits::default().max_message;
    let frame = |length: usize| zstd::bulk::compress(&vec![0; length], LEVEL).unwrap();
    let take = |frame: Vec<u8>| unpacked(Encoding::Other(0x8002), frame.into());
    assert_eq!(take(frame(most)).unwrap().1.len(), most);
    assert!(frame(most).len() < 10_000, "it is tempting");
    let refusal = take(frame(most + 1)).unwrap_err();
    assert!(matches!(refusal, UnpackError::TooLarge { got, .. } if got == most as u64 + 1), "{refusal}");

    // Claims that are not true: the eight bytes of the length in a header are the last of it.
    let of = |length: u64| {
        let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0xe0];
        frame.extend(length.to_le_bytes());
        // One last block that repeats a byte a thousand times.
        frame.extend([(1000 << 3 | 3) as u8, (1000 >> 5) as u8, 0, b'x']);
        frame
    };
    assert_eq!(take(of(1000)).unwrap().1, [b'x'; 1000][..]);
    assert!(matches!(take(of(u64::MAX - 2)), Err(UnpackError::TooLarge { .. })));
    for length in [0, 999, 1001, most as u64] {
        assert!(matches!(take(of(length)), Err(UnpackError::Damaged(_))), "{length}");
    }
    let two = [of(1000), of(1000)].concat();
    assert!(take(two).is_err());

    // A writer that does not know how long it will be states nothing.
    let mut stream = zstd::stream::Encoder::new(Vec::new(), LEVEL).unwrap();
    io::Write::write_all(&mut stream, &[0; 1000]).unwrap();
    assert!(matches!(take(stream.finish().unwrap()), Err(UnpackError::Unstated)));
}

#[test]
fn what_is_no_frame_is_refused() {
    let mut packer = Packer::new().unwrap();
    let body: Vec<u8> = noise(500).iter().flat_map(|byte| [*byte, 0, 0, 0]).collect();
    let (encoding, packed) = packer.pack(Encoding::Cdr, &body);
    let packed = packed.to_vec();
    for length in 0..packed.len() {
        assert!(unpacked(encoding, packed[..length].to_vec().into()).is_err(), "{length} bytes of {}", packed.len());
    }
    // Nothing checks content here, which is sealed: but whatever it is, it is taken or refused.
    for at in 0..packed.len() {
        let mut changed = packed.clone();
        changed[at] ^= 0x55;
        let _ = unpacked(encoding, changed.into());
    }
    assert!(unpacked(encoding, [&packed[..], b"more"].concat().into()).is_err());
}

/// By xorshift, which zstd does not see through.
fn noise(length: usize) -> Vec<u8> {
    let mut state = 1u32;
    let next = |_| {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state as u8
    };
    (0..length).map(next).collect()
}
