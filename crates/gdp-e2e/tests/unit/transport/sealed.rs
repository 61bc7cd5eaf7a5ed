//! Unit tests of `transport::sealed`.

use super::*;
use crate::seal::{Draft, Encoding, Writer};
use gdp_core::crypto::Backend;
use gdp_core::identity::SigningKey;
use gdp_core::keys::EpochKey;
use gdp_core::name::Name;

/// The sealed payloads are sent frame by frame, and every segment is found in its frame.
#[test]
fn frames_are_those_that_were_sealed() {
    let name = Name::from_bytes([1; 32]);
    let mut writer =
        Writer::new(name, name, SigningKey::from_secret_bytes(&[1; 32]).unwrap(), Backend::selected()).unwrap();
    writer.set_epoch(1, &EpochKey::from_bytes([1; 32])).unwrap();
    // A message alone, one of several segments, and a bundle.
    let bodies = [vec![1; 10], vec![2; 5000], vec![], vec![3; 64]];
    let drafts: Vec<Draft<'_>> = bodies.iter().map(|body| Draft::new(Encoding::Bytes, body)).collect();
    let mut segments = Segments::new();
    writer.seal_batch(0, &drafts, 1400, &mut segments).unwrap();

    let sealed = Sealed::new(segments.clone()).unwrap();
    assert_eq!((sealed.first(), sealed.last(), sealed.cut(), sealed.frames()), (1, 4, 0, segments.len()));
    assert_eq!(sealed.total_bytes(), segments.total_bytes());
    for (frame, payload) in segments.iter().enumerate() {
        assert_eq!(sealed.payload(frame), payload);
        assert_eq!(sealed.len(frame), payload.len());
    }
    for (id, bytes) in segments.segments() {
        for sequence in id.sequence..=id.last() {
            let frame = sealed.frame_of(Position { sequence, index: id.index });
            assert!(sealed.payload(frame).windows(bytes.len()).any(|window| window == bytes), "{id:?}");
        }
    }
    assert!(Sealed::new(Segments::new()).is_none());
}
