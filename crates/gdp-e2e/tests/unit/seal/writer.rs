//! Unit tests of `seal::writer`.

use super::*;

#[test]
fn a_session_ends_before_its_sequence_wraps() {
    let (mut writer, mut out) = (writer(), Segments::new());
    writer.next = wire::MAX_SEQUENCE - 1;
    writer.seal(0, Encoding::Bytes, b"last", 1000, &mut out).unwrap();
    assert_eq!(writer.seal(0, Encoding::Bytes, b"x", 1000, &mut out), Err(SealError::SequenceExhausted));
    assert!(out.is_empty());
    writer.heartbeat(0, u64::MAX, 1, &mut out).unwrap();
    writer.heartbeats = u32::MAX;
    assert_eq!(writer.heartbeat(0, u64::MAX, 1, &mut out), Err(SealError::SequenceExhausted));
    assert!(out.is_empty());
}

#[test]
fn an_epoch_ends_before_its_key_has_sealed_too_much() {
    let (mut writer, mut out) = (writer(), Segments::new());
    writer.epoch.as_mut().unwrap().used = MAX_SEGMENTS - 4;
    let batch = [Draft::new(Encoding::Bytes, &[1; 900]); 3];
    assert_eq!(writer.seal_batch(0, &batch, 1000, &mut out), Err(SealError::EpochExhausted(7)));
    // A refused batch uses no sequence numbers.
    assert_eq!(writer.next_sequence(), 1);
    writer.seal_batch(0, &batch[..1], 1000, &mut out).unwrap();
    writer.reseal(1, 1, 0, batch[0], 1000, &mut out).unwrap();
    assert_eq!(writer.heartbeat(0, u64::MAX, 1, &mut out), Err(SealError::EpochExhausted(7)));
    writer.set_epoch(8, &EpochKey::from_bytes([2; 32])).unwrap();
    writer.heartbeat(0, u64::MAX, 1, &mut out).unwrap();
}

#[test]
fn nothing_is_sealed_without_a_key_and_no_key_comes_back() {
    let (name, mut out) = (Name::from_bytes([1; 32]), Segments::new());
    let mut bare =
        Writer::new(name, name, SigningKey::from_secret_bytes(&[1; 32]).unwrap(), Backend::selected()).unwrap();
    assert_eq!(bare.seal(0, Encoding::Bytes, b"x", 1000, &mut out), Err(SealError::NoEpoch));
    assert_eq!(bare.heartbeat(0, u64::MAX, 1, &mut out), Err(SealError::NoEpoch));
    let mut writer = writer();
    for epoch in [0, 6, 7] {
        let refused = Err(SealError::EpochGoesBack { epoch, current: 7 });
        assert_eq!(writer.set_epoch(epoch, &EpochKey::from_bytes([2; 32])), refused);
    }
}

#[test]
fn a_cut_is_used_once_and_only_for_what_was_sealed() {
    let (mut writer, mut out) = (writer(), Segments::new());
    writer.seal(0, Encoding::Bytes, b"x", 1000, &mut out).unwrap();
    let mut reseal = |sequence, cut| {
        let result = writer.reseal(sequence, cut, 0, Draft::new(Encoding::Bytes, b"x"), 1000, &mut out);
        assert_eq!(result.is_ok(), !out.is_empty());
        result.is_ok()
    };
    let taken = [(0, 1), (1, 0), (1, 2), (1, 2), (1, 1), (1, 3), (1, u16::MAX), (2, 1)];
    assert_eq!(
        taken.map(|(sequence, cut)| reseal(sequence, cut)),
        [false, false, true, false, false, true, false, false]
    );
}

#[test]
fn messages_are_cut_anew_from_what_was_sealed() {
    let (mut writer, mut out, mut again) = (writer(), Segments::new(), Segments::new());
    let key = SigningKey::from_secret_bytes(&[1; 32]).unwrap().verify_key();
    // Three segments, and a bundle.
    let bodies = [vec![1; 3000], vec![2; 10], vec![]];
    let drafts = bodies.each_ref().map(|body| Draft { origin: b"here", ..Draft::new(Encoding::Cdr, body) });
    writer.seal_batch(77, &drafts, 1400, &mut out).unwrap();
    writer.set_epoch(8, &EpochKey::from_bytes([2; 32])).unwrap();
    let sealed: Vec<u8> = out.iter().flatten().copied().collect();
    writer.recut(&sealed, 1, 600, &mut again).unwrap();
    assert!(again.len() > out.len() && again.iter().all(|payload| payload.len() <= 600));

    let name = Name::from_bytes([1; 32]);
    let mut reader = crate::seal::Reader::new(name, Backend::selected(), Default::default());
    reader.authorise(name, key).unwrap();
    reader.set_key(&name, 8, EpochKey::from_bytes([2; 32])).unwrap();
    reader.confirm_session(&name, writer.session(), 1).unwrap();
    let mut received = crate::seal::Received::default();
    let now = crate::seal::Timestamps { steady_ns: 0, unix_ns: 77 };
    again.iter().for_each(|payload| reader.push(now, name, payload, &mut received).unwrap());
    for (i, (message, body)) in received.messages.iter().zip(&bodies).enumerate() {
        assert_eq!((message.sequence, message.timestamp_ns, &message.body[..]), (i as u64 + 1, 77, &body[..]));
        assert_eq!((&message.origin[..], message.encoding), (&b"here"[..], Encoding::Cdr));
    }
    assert_eq!(received.messages.len(), 3);

    assert!(matches!(writer.recut(&sealed, 1, 600, &mut again), Err(SealError::Cut { cut: 1, .. })));
    assert!(again.is_empty());
    // None of the cuts was used twice: each of the bundle's messages has its own.
    writer.reseal(3, 2, 77, drafts[2], 600, &mut again).unwrap();
    (9..24).for_each(|epoch| writer.set_epoch(epoch, &EpochKey::from_bytes([3; 32])).unwrap());
    assert!(matches!(writer.recut(&sealed, 2, 600, &mut again), Err(SealError::Cut { cut: 2, .. })));
}

/// Returns a writer in epoch 7.
fn writer() -> Writer {
    let name = Name::from_bytes([1; 32]);
    let mut writer =
        Writer::new(name, name, SigningKey::from_secret_bytes(&[1; 32]).unwrap(), Backend::selected()).unwrap();
    writer.set_epoch(7, &EpochKey::from_bytes([1; 32])).unwrap();
    writer
}
