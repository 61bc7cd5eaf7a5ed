//! Tests beyond a single message: sessions and their confirmation, epochs, new cuts, heartbeats.

use super::heartbeat::HeartbeatBody;
use super::tests::{DEADLINE, EPOCH, Fixture, at, limits, only, push_all, push_into};
use super::wire::{HEADER_LEN, HEARTBEAT_LEN, SegmentHeader};
use super::*;
use gdp_core::identity::SigningKey;
use gdp_core::keys::EpochKey;
use std::time::Duration;

const NEXT_KEY: [u8; 32] = [0x33; 32];

#[test]
fn a_session_that_nobody_vouched_for_is_refused_once_it_opened() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    let frames = f.seal(&mut writer, &[1; 3000], 1400);
    // An attacker without a key cannot cause this drop reason.
    let mut forged = frames[0].clone();
    forged[HEADER_LEN] ^= 1;
    assert_eq!(refusal(&mut reader, &f, &forged), Some(DropReason::Forged));
    for frame in &frames {
        assert_eq!(refusal(&mut reader, &f, frame), Some(DropReason::Unvouched));
    }
    assert_eq!(reader.memory(), 0);

    reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
    assert_eq!(only(push_all(&mut reader, f.writer_name(), &frames)).body, [1; 3000][..]);
    assert_eq!(reader.confirm_session(&f.name, writer.session(), 1), Err(DropReason::UnknownWriter));
}

#[test]
fn what_is_before_the_vouched_sequence_is_stale() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    // Small messages have one frame, large ones several.
    let history: Vec<_> = (0..6).map(|i| f.seal(&mut writer, &vec![i; 900 * usize::from(i % 3)], 1400)).collect();
    reader.confirm_session(&f.writer_name(), writer.session(), 5).unwrap();
    let refused: Vec<_> = history.iter().flatten().map(|frame| refusal(&mut reader, &f, frame)).collect();
    assert_eq!(refused.iter().filter(|reason| **reason == Some(DropReason::Stale)).count(), 5);
    assert_eq!(reader.drops()[DropReason::Stale as usize], 5, "each segment counts");
    assert_eq!(reader.memory(), 0);
    // A repeated confirmation can only lower the sequence, for a reader that may have older
    // messages.
    reader.confirm_session(&f.writer_name(), writer.session(), 2).unwrap();
    reader.confirm_session(&f.writer_name(), writer.session(), 6).unwrap();
    assert_eq!(push_all(&mut reader, f.writer_name(), history[1..4].iter().flatten()).len(), 3);
    assert_eq!(refusal(&mut reader, &f, &history[0][0]), Some(DropReason::Stale));
}

#[test]
fn a_forgotten_session_cannot_be_replayed() {
    let f = Fixture { limits: ReaderLimits { max_sessions: 3, ..limits() }, ..Fixture::new() };
    let mut reader = f.strict_reader();
    let mut recordings = vec![];
    for i in 0..10 {
        let mut writer = f.writer();
        reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
        recordings.push(f.seal(&mut writer, b"once", 1400).remove(0));
        assert_eq!(push_all(&mut reader, f.writer_name(), [&recordings[i]]).len(), 1, "session {i}");
    }
    for (i, recording) in recordings.iter().enumerate() {
        let expected = if i < 7 { DropReason::Unvouched } else { DropReason::Duplicate };
        assert_eq!(refusal(&mut reader, &f, recording), Some(expected), "session {i}");
    }
}

/// Other readers have the key, so they can make any number of sessions that open.
#[test]
fn sessions_that_nobody_vouched_for_displace_none_that_somebody_did() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
    let slow = f.seal(&mut writer, &[1; 2000], 1400);
    assert_eq!(refusal(&mut reader, &f, &slow[0]), None);
    let memory = reader.memory();
    for i in 100..200 {
        let mut insider = f.writer_in([i; 16], &SigningKey::from_secret_bytes(&[66; 32]).unwrap());
        for frame in f.seal(&mut insider, &[6; 2000], 1400) {
            assert_eq!(refusal(&mut reader, &f, &frame), Some(DropReason::Unvouched));
        }
    }
    assert_eq!(reader.memory(), memory);
    assert_eq!(push_all(&mut reader, f.writer_name(), &slow[1..]).len(), 1);
}

#[test]
fn what_was_signed_too_long_ago_is_too_old() {
    let f = Fixture { limits: ReaderLimits { max_age: Duration::from_nanos(100), ..limits() }, ..Fixture::new() };
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let mut segments = Segments::new();
    let mut push = |timestamp, unix_ns, body: &[u8]| {
        writer.seal(timestamp, Encoding::Bytes, body, 1400, &mut segments).unwrap();
        let (now, mut out) = (Timestamps { steady_ns: 0, unix_ns }, Received::default());
        segments.iter().try_for_each(|payload| reader.push(now, f.writer_name(), payload, &mut out))
    };
    for body in [&[][..], &[1; 3000]] {
        assert_eq!(push(1000, 1100, body), Ok(()));
        assert_eq!(push(1000, 1101, body), Err(DropReason::TooOld));
        // The writer's clock is ahead.
        assert_eq!(push(1000, 0, body), Ok(()));
    }
    let mut out = Received::default();
    writer.heartbeat(1000, u64::MAX, 1, &mut segments).unwrap();
    let payload = segments.iter().next().unwrap();
    let now = |unix_ns| Timestamps { steady_ns: 0, unix_ns };
    assert_eq!(reader.push(now(1101), f.writer_name(), payload, &mut out), Err(DropReason::TooOld));
    assert_eq!(reader.push(now(1100), f.writer_name(), payload, &mut out), Ok(()));
    assert_eq!(reader.memory(), 0);
}

#[test]
fn a_session_goes_on_over_epochs() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
    let before = f.seal(&mut writer, &[1; 3000], 1400);
    writer.set_epoch(EPOCH + 1, &EpochKey::from_bytes(NEXT_KEY)).unwrap();
    let after = f.seal(&mut writer, &[2; 3000], 1400);
    assert_eq!(refusal(&mut reader, &f, &after[0]), Some(DropReason::NoKey));
    reader.set_key(&f.writer_name(), EPOCH + 1, EpochKey::from_bytes(NEXT_KEY)).unwrap();
    // Frames of both epochs, interleaved.
    let mixed = [&before[0], &after[1], &after[0], &before[1], &after[2], &before[2]];
    let messages = push_all(&mut reader, f.writer_name(), mixed);
    assert_eq!(messages.iter().map(|message| message.sequence).collect::<Vec<_>>(), [2, 1]);
    assert_eq!(refusal(&mut reader, &f, &before[0]), Some(DropReason::Duplicate));

    // A dropped key opens nothing, but an incomplete message can still be completed later.
    let (slow, late) = (f.seal(&mut writer, &[3; 3000], 1400), f.seal(&mut writer, &[4; 3000], 1400));
    assert_eq!(refusal(&mut reader, &f, &slow[0]), None);
    reader.drop_key(&f.writer_name(), EPOCH + 1);
    assert_eq!(refusal(&mut reader, &f, &late[0]), Some(DropReason::NoKey));
    assert_eq!(refusal(&mut reader, &f, &slow[1]), Some(DropReason::NoKey));
    reader.set_key(&f.writer_name(), EPOCH + 1, EpochKey::from_bytes(NEXT_KEY)).unwrap();
    assert_eq!(push_all(&mut reader, f.writer_name(), slow[1..].iter().chain(&late)).len(), 2);
    assert_eq!(reader.set_key(&f.name, 1, EpochKey::from_bytes(NEXT_KEY)), Err(DropReason::UnknownWriter));
}

#[test]
fn segments_of_one_epoch_do_not_open_in_another() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.reader());
    reader.set_key(&f.writer_name(), EPOCH + 1, EpochKey::from_bytes(NEXT_KEY)).unwrap();
    let mut moved = f.seal(&mut writer, b"x", 1400).remove(0);
    moved[40..44].copy_from_slice(&(EPOCH + 1).to_be_bytes());
    assert_eq!(refusal(&mut reader, &f, &moved), Some(DropReason::Forged));
    // A key that was replaced under its epoch number is no longer used.
    let frame = f.seal(&mut writer, b"x", 1400).remove(0);
    reader.set_key(&f.writer_name(), EPOCH, EpochKey::from_bytes(NEXT_KEY)).unwrap();
    assert_eq!(refusal(&mut reader, &f, &frame), Some(DropReason::Forged));
}

#[test]
fn a_reader_keeps_a_few_keys_of_each_writer_the_highest() {
    let f = Fixture::new();
    let mut reader = f.reader();
    for epoch in (EPOCH + 1..).take(source::MAX_EPOCHS) {
        reader.set_key(&f.writer_name(), epoch, EpochKey::from_bytes(NEXT_KEY)).unwrap();
    }
    let mut writer = f.writer();
    assert_eq!(refusal(&mut reader, &f, &f.seal(&mut writer, b"x", 1400)[0]), Some(DropReason::NoKey));
    writer.set_epoch(EPOCH + 1, &EpochKey::from_bytes(NEXT_KEY)).unwrap();
    assert_eq!(refusal(&mut reader, &f, &f.seal(&mut writer, b"x", 1400)[0]), None);
}

/// Frames of both cuts are in flight. The cut that is complete first is delivered, once.
#[test]
fn a_message_that_is_cut_anew_is_delivered_once() {
    let f = Fixture::new();
    let body = [7; 3000];
    for (first, expected_segments) in [(0, 3), (1, 13)] {
        let (mut writer, mut reader) = (f.writer(), f.strict_reader());
        reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
        let wide = f.seal(&mut writer, &body, 1400);
        let narrow = cut_anew(&mut writer, 1, &body, 300);
        assert!(narrow.iter().all(|frame| frame.len() <= 300));
        let cuts = [&wide, &narrow];
        // All frames except one of the first cut, all of the second, and the rest.
        let (winner, loser) = (cuts[first], cuts[1 - first]);
        let mut out = Received::default();
        push_into(&mut reader, f.writer_name(), &loser[1..], &mut out);
        for frame in winner {
            assert!(out.messages.is_empty());
            push_into(&mut reader, f.writer_name(), [frame], &mut out);
        }
        let message = only(std::mem::take(&mut out.messages));
        assert_eq!((message.sequence, &message.body[..]), (1, &body[..]));
        assert_eq!(
            out.segments.iter().filter(|id| usize::from(id.cut) == first && id.index < id.count).count(),
            expected_segments
        );
        assert_eq!(reader.memory(), 0, "the other cut was let go");
        for frame in wide.iter().chain(&narrow) {
            assert_eq!(refusal(&mut reader, &f, frame), Some(DropReason::Duplicate));
        }
        assert_eq!(reader.drops()[DropReason::Evicted as usize], 0);
    }
}

/// Another reader spoils one cut, which does not affect the next cut.
#[test]
fn a_cut_that_was_spoilt_does_not_spoil_the_next() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
    let mut insider = f.writer_in(writer.session(), &SigningKey::from_secret_bytes(&[66; 32]).unwrap());
    let (honest, forged) = (f.seal(&mut writer, &[1; 2000], 1400), f.seal(&mut insider, &[6; 2000], 1400));
    assert_eq!(refusal(&mut reader, &f, &forged[0]), None);
    assert_eq!(refusal(&mut reader, &f, &honest[1]), Some(DropReason::BadSignature));
    assert_eq!(push_all(&mut reader, f.writer_name(), cut_anew(&mut writer, 1, &[1; 2000], 1400)).len(), 1);
}

/// The nonces of all cuts, epochs and heartbeats of a session.
#[test]
fn no_nonce_is_used_twice_under_one_key() {
    let f = Fixture::new();
    let (mut writer, mut segments) = (f.writer(), Segments::new());
    let mut used = std::collections::HashSet::new();
    for epoch in [EPOCH + 1, EPOCH + 2] {
        writer.set_epoch(epoch, &EpochKey::from_bytes(NEXT_KEY)).unwrap();
        for round in 0..20u16 {
            let small = Draft::new(Encoding::Bytes, b"small");
            let batch = [Draft::new(Encoding::Bytes, &[1; 700]), small, small];
            writer.seal_batch(0, &batch, 400, &mut segments).unwrap();
            note(&segments, &mut used);
            // Both messages of the bundle, and the bundle itself.
            let sealed: Vec<u8> = segments.iter().flatten().copied().collect();
            writer.recut(&sealed, 1, 350, &mut segments).unwrap();
            note(&segments, &mut used);
            let sequence = writer.next_sequence() - 1;
            for cut in 2..5 {
                writer.reseal(sequence, cut, 0, batch[1], 300 + usize::from(round), &mut segments).unwrap();
                note(&segments, &mut used);
            }
            for _ in 0..3 {
                writer.heartbeat(0, u64::MAX, 1, &mut segments).unwrap();
                note(&segments, &mut used);
            }
        }
    }
}

/// A bundle that comes after one of its messages delivers the others.
#[test]
fn a_message_of_a_bundle_is_delivered_once() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    let mut bundle = Segments::new();
    let drafts = [b"a", b"b", b"c", b"d"].map(|body| Draft::new(Encoding::Bytes, body));
    writer.seal_batch(0, &drafts, 1400, &mut bundle).unwrap();
    let again = cut_anew(&mut writer, 3, b"c", 1400);
    let bundle = bundle.iter().next().unwrap();
    assert_eq!(refusal(&mut reader, &f, bundle), Some(DropReason::Unvouched));
    reader.confirm_session(&f.writer_name(), writer.session(), 2).unwrap();
    let mut out = Received::default();
    push_into(&mut reader, f.writer_name(), [&again[0][..], bundle], &mut out);
    let delivered: Vec<_> = out.messages.iter().map(|message| (message.sequence, &message.body[..])).collect();
    assert_eq!(delivered, [(3, &b"c"[..]), (2, b"b"), (4, b"d")]);
    assert_eq!(out.segments.iter().map(|id| (id.sequence, id.last())).collect::<Vec<_>>(), [(3, 3), (1, 4)]);
    for frame in [bundle, &again[0]] {
        assert_eq!(refusal(&mut reader, &f, frame), Some(DropReason::Duplicate));
    }
    reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
    assert_eq!(only(push_all(&mut reader, f.writer_name(), [bundle])).sequence, 1);
}

#[test]
fn heartbeats_say_how_far_a_session_is() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    let first = beat(&mut writer, 1);
    assert_eq!(refusal(&mut reader, &f, &first), Some(DropReason::Unvouched));
    reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
    let mut out = Received::default();
    push_into(&mut reader, f.writer_name(), [&first], &mut out);
    f.seal(&mut writer, b"lost", 1400);
    let (second, third) = (beat(&mut writer, 1), beat(&mut writer, 2));
    push_into(&mut reader, f.writer_name(), [&third], &mut out);
    let session = writer.session();
    let heartbeat = |next, oldest| Heartbeat { session, next, oldest, timestamp_ns: 77 };
    assert_eq!(out.heartbeats, [heartbeat(1, 1), heartbeat(2, 2)]);
    // Overtaken and repeated heartbeats.
    for old in [&first, &second, &third] {
        assert_eq!(refusal(&mut reader, &f, old), Some(DropReason::Duplicate));
    }
    // The announced message is still accepted.
    let resealed = cut_anew(&mut writer, 1, b"lost", 1400);
    assert_eq!(push_all(&mut reader, f.writer_name(), resealed).len(), 1);
    assert_eq!(reader.memory(), 0);
}

#[test]
fn a_heartbeat_from_before_the_vouched_sequence_is_stale() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    let old = beat(&mut writer, 1);
    f.seal(&mut writer, b"x", 1400);
    reader.confirm_session(&f.writer_name(), writer.session(), 2).unwrap();
    assert_eq!(refusal(&mut reader, &f, &old), Some(DropReason::Stale));
    assert_eq!(refusal(&mut reader, &f, &beat(&mut writer, 1)), None);
}

/// Another reader has the epoch key and can make heartbeats that open. None of them counts, and
/// none blocks a genuine one.
#[test]
fn another_reader_cannot_forge_a_heartbeat() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.strict_reader());
    reader.confirm_session(&f.writer_name(), writer.session(), 1).unwrap();
    let true_one = beat(&mut writer, 1);
    let mut insider = f.writer_in(writer.session(), &SigningKey::from_secret_bytes(&[66; 32]).unwrap());
    for _ in 0..50 {
        f.seal(&mut insider, b"x", 1400);
        assert_eq!(refusal(&mut reader, &f, &beat(&mut insider, 40)), Some(DropReason::BadSignature));
    }
    // The writer's own signature, with another number, next sequence or age, or in another session.
    let aead = f.epoch_key.session_key(f.writing, &f.name, &f.writer_name(), &writer.session()).unwrap().aead;
    let clear: [u8; HEADER_LEN] = true_one[..HEADER_LEN].try_into().unwrap();
    let header = SegmentHeader::parse(&clear).unwrap();
    let (ciphertext, tag) = true_one[HEADER_LEN..].split_last_chunk().unwrap();
    let mut plaintext = [0; HEARTBEAT_LEN];
    aead.open(&header.nonce(), &clear, ciphertext, tag, &mut plaintext).unwrap();
    let (body, signature) = HeartbeatBody::parse(&plaintext).unwrap();
    let seal = |header: SegmentHeader, body: HeartbeatBody| {
        let (clear, mut sealed) = (header.to_bytes(), body.to_bytes(signature));
        let tag = aead.seal(&header.nonce(), &clear, &mut sealed).unwrap();
        [&clear[..], &sealed, &tag].concat()
    };
    assert_eq!(seal(header, body), true_one);
    for (what, forged) in [
        ("number", seal(SegmentHeader { index: 9, ..header }, body)),
        ("next", seal(SegmentHeader { sequence: 9, ..header }, body)),
        ("oldest", seal(header, HeartbeatBody { oldest: 9, ..body })),
        ("age", seal(header, HeartbeatBody { timestamp_ns: u64::MAX, ..body })),
    ] {
        assert_eq!(refusal(&mut reader, &f, &forged), Some(DropReason::BadSignature), "{what}");
    }
    assert_eq!(refusal(&mut reader, &f, &true_one), None);
    assert_eq!(reader.memory(), 0);
}

#[test]
fn replies_and_origins_are_carried() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let mut segments = Segments::new();
    let request = MessageId { session: [9; 16], sequence: u64::MAX };
    let full = Draft { in_reply_to: Some(request), origin: &[4; MAX_ORIGIN], ..Draft::new(Encoding::Ros1, b"body") };
    // In one segment, and with a cut within the extensions.
    for max_payload in [1400, MIN_PAYLOAD] {
        writer.seal_batch(5, &[full], max_payload, &mut segments).unwrap();
        let message = only(push_all(&mut reader, f.writer_name(), segments.iter()));
        assert_eq!((message.in_reply_to, &message.origin[..]), (full.in_reply_to, full.origin));
        assert_eq!((message.encoding, &message.body[..]), (Encoding::Ros1, full.body));
    }
    let too_long = Draft { origin: &[4; MAX_ORIGIN + 1], ..full };
    assert_eq!(writer.seal_batch(5, &[too_long], 1400, &mut segments), Err(SealError::OriginTooLong(65)));
    assert!(segments.is_empty());
}

#[test]
fn a_reader_says_which_segments_it_has() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let mut segments = Segments::new();
    writer
        .seal_batch(
            0,
            &[Draft::new(Encoding::Bytes, &[1; 3000]), Draft::new(Encoding::Bytes, b"x")],
            1400,
            &mut segments,
        )
        .unwrap();
    let sealed: Vec<_> = segments.segments().map(|(id, _)| id).collect();
    assert_eq!(sealed.iter().map(|id| (id.sequence, id.index)).collect::<Vec<_>>(), [(1, 0), (1, 1), (1, 2), (2, 0)]);
    assert_eq!(sealed.iter().map(|id| id.len).sum::<usize>(), segments.total_bytes());
    let mut out = Received::default();
    push_into(&mut reader, f.writer_name(), segments.iter(), &mut out);
    assert_eq!(out.segments, sealed);
    // Each segment alone is a valid payload.
    let mut reader = f.reader();
    let single = segments.segments().map(|(_, bytes)| bytes);
    assert_eq!(push_all(&mut reader, f.writer_name(), single).len(), 2);
    // Refused and repeated segments are not in the list.
    out.clear();
    for payload in segments.iter() {
        let _ = reader.push(at(DEADLINE), f.writer_name(), payload, &mut out);
    }
    assert!(out.segments.is_empty());
}

fn refusal(reader: &mut Reader, f: &Fixture, payload: &[u8]) -> Option<DropReason> {
    reader.push(at(0), f.writer_name(), payload, &mut Received::default()).err()
}

fn cut_anew(writer: &mut Writer, sequence: u64, body: &[u8], max_payload: usize) -> Vec<Vec<u8>> {
    let mut segments = Segments::new();
    writer.reseal(sequence, 1, sequence, Draft::new(Encoding::Bytes, body), max_payload, &mut segments).unwrap();
    segments.iter().map(<[u8]>::to_vec).collect()
}

fn beat(writer: &mut Writer, oldest: u64) -> Vec<u8> {
    let mut segments = Segments::new();
    writer.heartbeat(77, u64::MAX, oldest, &mut segments).unwrap();
    assert_eq!(segments.len(), 1);
    segments.iter().next().unwrap().to_vec()
}

/// Adds the nonce and epoch of each segment.
fn note(segments: &Segments, used: &mut std::collections::HashSet<([u8; 12], u32)>) {
    for (_, bytes) in segments.segments() {
        let header = SegmentHeader::parse(bytes[..HEADER_LEN].try_into().unwrap()).unwrap();
        assert!(used.insert((header.nonce(), header.epoch)), "{header:?}");
    }
}
