//! The cases that must fail, and their drop reasons.

use super::tests::{EPOCH, Fixture, at, only, push_all};
use super::wire::{HEADER_LEN, OVERHEAD, Proof, SegmentHeader, VERSION};
use super::*;
use gdp_core::crypto::{Aead, TAG_LEN};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::EpochKey;
use gdp_core::name::Name;
use gdp_faults::Random;

#[test]
fn no_flipped_bit_is_delivered_or_costs_memory() {
    let f = Fixture::new();
    let frame = f.seal(&mut f.writer(), b"attack at dawn", 1400).remove(0);
    for bit in 0..frame.len() * 8 {
        let mut changed = frame.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let mut reader = f.reader();
        let mut out = Received::default();
        let error = reader.push(at(0), f.writer_name(), &changed, &mut out).unwrap_err();
        assert!(out.messages.is_empty(), "bit {bit}");
        assert!(reader.drops()[error as usize] > 0);
        assert_eq!(reader.memory(), 0, "bit {bit}");
        if bit / 8 >= HEADER_LEN {
            assert_eq!(error, DropReason::Forged, "bit {bit}");
        }
        // The original frame is still accepted afterwards.
        let mut out = Received::default();
        let _ = reader.push(at(0), f.writer_name(), &frame, &mut out);
        assert_eq!(only(out.messages).body, "attack at dawn");
    }
}

#[test]
fn a_forged_segment_costs_no_memory_and_no_session() {
    let f = Fixture::new();
    let mut reader = f.reader();
    let mut random = Random::new(3);
    let frames = f.seal(&mut f.writer(), &[1; 5000], 1400);
    for _ in 0..1000 {
        let mut frame = frames[0].clone();
        frame[16..32].copy_from_slice(&random.bytes(16));
        assert_eq!(reader.push(at(0), f.writer_name(), &frame, &mut Received::default()), Err(DropReason::Forged));
    }
    assert_eq!((reader.memory(), reader.next_deadline()), (0, None));
    assert_eq!(reader.drops()[DropReason::Forged as usize], 1000);
}

#[test]
fn a_forged_segment_in_a_known_message_does_not_spoil_it() {
    let f = Fixture::new();
    let mut reader = f.reader();
    let frames = f.seal(&mut f.writer(), &[7; 5000], 1400);
    let mut out = Received::default();
    for frame in &frames {
        let mut forged = frame.clone();
        *forged.last_mut().unwrap() ^= 1;
        forged[HEADER_LEN] ^= 1;
        let _ = reader.push(at(0), f.writer_name(), &forged, &mut out);
        reader.push(at(0), f.writer_name(), frame, &mut out).unwrap();
        let _ = reader.push(at(0), f.writer_name(), &forged, &mut out);
    }
    assert_eq!(only(out.messages).body, [7; 5000][..]);
}

#[test]
fn truncated_frames_are_refused_at_every_length() {
    let f = Fixture::new();
    let frames = f.seal(&mut f.writer(), &[1; 2000], 1400);
    for frame in &frames {
        for len in 0..frame.len() {
            let mut reader = f.reader();
            let mut out = Received::default();
            let result = reader.push(at(0), f.writer_name(), &frame[..len], &mut out);
            // A cut between two segments leaves a complete segment.
            let whole = len > 0 && split_ends(frame).contains(&len);
            assert_eq!(result.is_ok(), whole, "length {len}");
            assert!(result.is_ok() || result == Err(DropReason::Truncated), "length {len}: {result:?}");
            assert!(out.messages.is_empty());
        }
    }
}

#[test]
fn random_bytes_and_random_headers_never_panic() {
    let f = Fixture::new();
    let mut reader = f.reader();
    let mut random = Random::new(9);
    for _ in 0..20_000 {
        let len = random.below(300) as usize;
        let mut payload = random.bytes(len);
        if len >= HEADER_LEN && random.below(2) == 0 {
            payload[0] = VERSION;
            payload[1] &= 3;
            payload[2..4].copy_from_slice(&((len - HEADER_LEN) as u16).to_be_bytes());
            if random.below(2) == 0 {
                payload[40..44].copy_from_slice(&EPOCH.to_be_bytes());
                payload[4..8].copy_from_slice(&[0; 4]);
                payload[32..36].copy_from_slice(&[0, 0, 0, random.below(3) as u8]);
                payload[36..40].copy_from_slice(&[0, 0, 1, 0]);
            }
        }
        assert!(reader.push(at(0), f.writer_name(), &payload, &mut Received::default()).is_err());
    }
    assert_eq!(reader.memory(), 0);
    assert_eq!(reader.drops().iter().sum::<u64>(), 20_000);
}

#[test]
fn replays_are_refused_however_they_come() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let history: Vec<_> = (0..1500).map(|i: u32| f.seal(&mut writer, &i.to_be_bytes(), 1400).remove(0)).collect();
    for frame in &history {
        assert_eq!(push_all(&mut reader, f.writer_name(), [frame]).len(), 1);
    }
    let mut out = Received::default();
    for (i, frame) in history.iter().enumerate() {
        let expected = if i < 1500 - 1024 { DropReason::TooOld } else { DropReason::Duplicate };
        assert_eq!(reader.push(at(0), f.writer_name(), frame, &mut out), Err(expected), "message {i}");
    }
    assert!(out.messages.is_empty());
    assert_eq!(reader.memory(), 0);
}

/// The window has moved on, so the reader can no longer tell whether the message was delivered.
#[test]
fn a_message_that_completes_behind_the_window_is_too_old() {
    let f = Fixture::new();
    // The last segment to arrive is the proof, or a body segment that opens in its slot.
    for last in [0, 1] {
        let (mut writer, mut reader) = (f.writer(), f.reader());
        let slow = f.seal(&mut writer, &[1; 2000], 1400);
        assert!(push_all(&mut reader, f.writer_name(), [&slow[1 - last]]).is_empty());
        for _ in 0..1024 {
            push_all(&mut reader, f.writer_name(), f.seal(&mut writer, b"", 1400));
        }
        let mut out = Received::default();
        assert_eq!(reader.push(at(0), f.writer_name(), &slow[last], &mut out), Err(DropReason::TooOld));
        assert!(out.messages.is_empty());
        assert_eq!(reader.memory(), 0);
    }
}

#[test]
fn frames_of_another_name_writer_session_or_epoch_do_not_open() {
    let f = Fixture::new();
    let frame = |f: &Fixture| f.seal(&mut f.writer(), b"x", 1400).remove(0);
    let refused = |frame: &[u8]| f.reader().push(at(0), f.writer_name(), frame, &mut Received::default()).unwrap_err();

    assert_eq!(refused(&frame(&Fixture { name: Name::from_bytes([9; 32]), ..Fixture::new() })), DropReason::Forged);
    assert_eq!(
        refused(&frame(&Fixture { epoch_key: EpochKey::from_bytes([9; 32]), ..Fixture::new() })),
        DropReason::Forged
    );

    // A frame of another entity under this writer's name, and the reverse.
    let mut reader = f.reader();
    f.introduce(&mut reader, &f.other);
    let of_other = f.seal(&mut f.writer_of(&f.other), b"x", 1400).remove(0);
    assert_eq!(reader.push(at(0), f.writer_name(), &of_other, &mut Received::default()), Err(DropReason::Forged));
    assert_eq!(reader.push(at(0), f.other.name(), &frame(&f), &mut Received::default()), Err(DropReason::Forged));
    let nobody = Name::from_bytes([1; 32]);
    assert_eq!(reader.push(at(0), nobody, &frame(&f), &mut Received::default()), Err(DropReason::UnknownWriter));

    // A segment that claims another session of the same writer.
    let (a, b) = (f.writer(), f.writer());
    let mut reader = f.reader();
    let mut moved = f.seal(&mut { a }, b"x", 1400).remove(0);
    moved[16..32].copy_from_slice(&b.session());
    assert_eq!(reader.push(at(0), f.writer_name(), &moved, &mut Received::default()), Err(DropReason::Forged));
}

/// A reader has the epoch key and can seal, but cannot sign.
#[test]
fn another_reader_cannot_write() {
    let f = Fixture::new();
    let insider = Identity::new(SigningKey::from_secret_bytes(&[66; 32]).unwrap(), "proxy");
    let mut forger = f.writer_in([6; 16], insider.key());
    let mut reader = f.reader();
    let mut out = Received::default();
    for _ in 0..100 {
        for frame in f.seal(&mut forger, &[6; 3000], 1400) {
            let _ = reader.push(at(0), f.writer_name(), &frame, &mut out);
        }
    }
    assert!(out.messages.is_empty());
    assert_eq!(reader.drops()[DropReason::BadSignature as usize], 100);
    assert_eq!(reader.memory(), 0);
    // It did not advance any window either.
    assert_eq!(push_all(&mut reader, f.writer_name(), f.seal(&mut f.writer(), b"honest", 1400)).len(), 1);
}

/// An insider forges segments within an honest session, with sequences far ahead. They must not
/// make honest segments too old.
#[test]
fn an_insider_cannot_move_an_honest_window() {
    let f = Fixture::new();
    let insider = SigningKey::from_secret_bytes(&[66; 32]).unwrap();
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let mut forger = f.writer_in(writer.session(), &insider);
    for _ in 0..3000 {
        let frame = f.seal(&mut forger, b"x", 1400).remove(0);
        let result = reader.push(at(0), f.writer_name(), &frame, &mut Received::default());
        assert_eq!(result, Err(DropReason::BadSignature));
    }
    assert_eq!(push_all(&mut reader, f.writer_name(), f.seal(&mut writer, b"honest", 1400)).len(), 1);
}

#[test]
fn impossible_sizes_are_refused_before_anything_else() {
    let f = Fixture::new();
    let mut reader = f.reader();
    let frame = f.seal(&mut f.writer(), &[1; 5000], 1400).remove(0);
    let with = |count: u32, size: u32, index: u32| {
        let mut changed = frame.clone();
        changed[4..8].copy_from_slice(&index.to_be_bytes());
        changed[32..36].copy_from_slice(&count.to_be_bytes());
        changed[36..40].copy_from_slice(&size.to_be_bytes());
        changed
    };
    for (what, frame, expected) in [
        ("most segments", with(u32::MAX, 1340, 0), DropReason::TooLarge),
        ("one segment too many", with(152, 1340, 0), DropReason::TooLarge),
        ("no segments", with(0, 1340, 0), DropReason::BadHeader),
        ("index past the end", with(4, 1340, 4), DropReason::BadHeader),
        ("size of 4 GB", with(1, u32::MAX, 0), DropReason::BadHeader),
        ("other size", with(4, 1343, 0), DropReason::BadHeader),
    ] {
        assert_eq!(reader.push(at(0), f.writer_name(), &frame, &mut Received::default()), Err(expected), "{what}");
    }
    assert_eq!(reader.memory(), 0);
}

/// An insider with the key announces many large messages and never completes them.
#[test]
fn authentic_but_endless_messages_stay_within_the_limits() {
    let f = Fixture::new();
    let mut reader = f.reader();
    let mut out = Received::default();
    for session in 0..40 {
        let mut writer = f.writer();
        reader.confirm_session(&f.writer_name(), writer.session(), 0).unwrap();
        for _ in 0..20 {
            let frames = f.seal(&mut writer, &[1; 100_000], 1400);
            let _ = reader.push(at(session), f.writer_name(), &frames[0], &mut out);
            assert!(reader.memory() <= f.limits.max_memory_per_source);
        }
    }
    assert!(reader.drops()[DropReason::Evicted as usize] > 700);
    // Many small messages, each without its end.
    let mut writer = f.writer();
    reader.confirm_session(&f.writer_name(), writer.session(), 0).unwrap();
    for _ in 0..2000 {
        let frames = f.seal(&mut writer, &[1; 100], OVERHEAD + 100);
        let _ = reader.push(at(50), f.writer_name(), &frames[0], &mut out);
    }
    assert!(reader.memory() <= f.limits.max_memory_per_source);
    assert!(out.messages.is_empty());
    // An honest message is still delivered.
    let mut writer = f.writer();
    reader.confirm_session(&f.writer_name(), writer.session(), 0).unwrap();
    assert_eq!(push_all(&mut reader, f.writer_name(), f.seal(&mut writer, &[5; 4000], 1400)).len(), 1);
}

#[test]
fn segments_of_one_message_agree_on_its_shape() {
    let f = Fixture::new();
    let mut reader = f.reader();
    let writer = || f.writer_in([5; 16], f.entity.key());
    let (wide, narrow) = (f.seal(&mut writer(), &[1; 3000], 1400), f.seal(&mut writer(), &[1; 3000], 1000));
    reader.push(at(0), f.writer_name(), &wide[0], &mut Received::default()).unwrap();
    assert_eq!(
        reader.push(at(0), f.writer_name(), &narrow[1], &mut Received::default()),
        Err(DropReason::Inconsistent)
    );
}

/// A proof is bound to its message: a proof from the same batch does not prove another message.
#[test]
fn proofs_cannot_be_exchanged_within_a_batch() {
    let f = Fixture::new();
    let (mut writer, mut segments) = (f.writer(), Segments::new());
    let drafts = [[1; 1000], [2; 1000]];
    let drafts = drafts.each_ref().map(|body| Draft::new(Encoding::Bytes, body));
    writer.seal_batch(0, &drafts, 1400, &mut segments).unwrap();
    let [first, second] = [0, 1].map(|at| segments.iter().nth(at).unwrap().to_vec());

    // An insider puts the second proof behind the first message.
    let insider = Insider::new(&f, &writer);
    let ((header, honest), (_, stolen)) = (insider.open(&first), insider.open(&second));
    let (part, _) = Proof::split(&honest).unwrap();
    let (_, proof) = Proof::split(&stolen).unwrap();
    assert_eq!(proof.position, 1);
    let forged = insider.seal(header, &[part, &stolen[part.len()..]].concat());

    let mut reader = f.reader();
    assert_eq!(refusal(&mut reader, &f, &forged), Some(DropReason::BadSignature));
    assert_eq!(push_all(&mut reader, f.writer_name(), [&first, &second]).len(), 2);
}

/// The form of a signature that anybody can make of another one.
#[test]
fn a_high_s_is_refused_by_name() {
    let f = Fixture::new();
    let (mut writer, mut reader) = (f.writer(), f.reader());
    let honest = f.seal(&mut writer, b"x", 1400).remove(0);
    let mut beat = Segments::new();
    writer.heartbeat(0, u64::MAX, 1, &mut beat).unwrap();
    let beat = beat.iter().next().unwrap();
    let insider = Insider::new(&f, &writer);
    // The signature is before the last four bytes of a proof, and at the end of a heartbeat.
    for (frame, end) in [(&honest[..], 4), (beat, 0)] {
        let (header, mut plaintext) = insider.open(frame);
        let end = plaintext.len() - end;
        let signature = plaintext[..end].last_chunk_mut::<64>().unwrap();
        let (r, s) = p256::ecdsa::Signature::from_slice(signature).unwrap().split_scalars();
        let high = p256::ecdsa::Signature::from_scalars(r.to_bytes(), (-*s).to_bytes()).unwrap();
        *signature = high.to_bytes().into();
        assert_eq!(refusal(&mut reader, &f, &insider.seal(header, &plaintext)), Some(DropReason::HighS));
        assert_eq!(refusal(&mut reader, &f, frame), None);
    }
}

/// An epoch has one key. What was signed under it does not count under another key of its number.
#[test]
fn a_message_is_signed_for_one_key() {
    let f = Fixture::new();
    let mut writer = f.writer();
    let honest = f.seal(&mut writer, b"x", 1400).remove(0);
    let other = Fixture { epoch_key: EpochKey::from_bytes([9; 32]), ..Fixture::new() };
    let (header, plaintext) = Insider::new(&f, &writer).open(&honest);
    let moved = Insider::new(&other, &writer).seal(header, &plaintext);
    assert_eq!(refusal(&mut other.reader(), &other, &moved), Some(DropReason::BadSignature));
    assert_eq!(refusal(&mut f.reader(), &f, &honest), None);
}

/// An insider rewrites, adds or drops a message of a bundle.
#[test]
fn a_bundle_is_signed_as_a_whole() {
    let f = Fixture::new();
    let (mut writer, mut segments) = (f.writer(), Segments::new());
    writer.seal_batch(0, &[Draft::new(Encoding::Bytes, b"go"); 3], 1400, &mut segments).unwrap();
    let honest = segments.iter().next().unwrap();
    let insider = Insider::new(&f, &writer);
    let (header, plaintext) = insider.open(honest);
    assert_eq!((header.count, header.size), (3, 8 + 3 * 8));
    let mut rewritten = plaintext.clone();
    rewritten[8 + 6..8 + 8].copy_from_slice(b"no");
    let fewer = SegmentHeader { count: 2, size: header.size - 8, ..header };
    let more = SegmentHeader { count: 4, ..header };
    let mut reader = f.reader();
    for forged in [
        insider.seal(header, &rewritten),
        insider.seal(
            fewer,
            &plaintext[..plaintext.len() - 76].iter().chain(&plaintext[32..]).copied().collect::<Vec<_>>(),
        ),
        insider.seal(more, &plaintext),
        insider.seal(SegmentHeader { sequence: 2, ..header }, &plaintext),
    ] {
        let mut out = Received::default();
        let refused = reader.push(at(0), f.writer_name(), &forged, &mut out);
        assert_eq!(refused, Err(DropReason::BadSignature));
        assert!(out.messages.is_empty());
        // The reliable transport asks for all of its messages again.
        let (_, lost) = (out.segments, out.lost.iter().map(|lost| lost.again).collect::<Vec<_>>());
        assert!(lost.iter().all(|again| *again) && lost.len() >= 2, "{lost:?}");
    }
    assert_eq!(push_all(&mut reader, f.writer_name(), [honest]).len(), 3);
}

/// The end of a message comes behind a segment that is not full.
#[test]
fn segments_that_leave_a_gap_are_refused() {
    let f = Fixture::new();
    let mut writer = f.writer();
    let insider = Insider::new(&f, &writer);
    let frames = f.seal(&mut writer, &[1; 1500], 1400);
    let (header, plaintext) = insider.open(&frames[0]);
    let sealed_len = header.sealed_len - 1;
    let short = insider.seal(SegmentHeader { sealed_len, ..header }, &plaintext[..plaintext.len() - 1]);
    let mut reader = f.reader();
    assert_eq!(refusal(&mut reader, &f, &short), None);
    assert_eq!(refusal(&mut reader, &f, &frames[1]), Some(DropReason::BadMessage));
    assert_eq!(reader.memory(), 0);
}

/// Another reader, which has the key of the epoch.
struct Insider(Aead);

impl Insider {
    fn new(f: &Fixture, writer: &Writer) -> Self {
        Self(f.epoch_key.session_key(f.writing, &f.name, &f.writer_name(), &writer.session()).unwrap().aead)
    }

    fn open(&self, segment: &[u8]) -> (SegmentHeader, Vec<u8>) {
        let (clear, sealed) = segment.split_first_chunk::<HEADER_LEN>().unwrap();
        let (ciphertext, tag) = sealed.split_last_chunk::<TAG_LEN>().unwrap();
        let header = SegmentHeader::parse(clear).unwrap();
        let mut plaintext = vec![0; ciphertext.len()];
        self.0.open(&header.nonce(), clear, ciphertext, tag, &mut plaintext).unwrap();
        (header, plaintext)
    }

    fn seal(&self, header: SegmentHeader, plaintext: &[u8]) -> Vec<u8> {
        let header = SegmentHeader { sealed_len: (plaintext.len() + TAG_LEN) as u16, ..header };
        let (clear, mut sealed) = (header.to_bytes(), plaintext.to_vec());
        let tag = self.0.seal(&header.nonce(), &clear, &mut sealed).unwrap();
        [&clear[..], &sealed, &tag].concat()
    }
}

fn refusal(reader: &mut Reader, f: &Fixture, payload: &[u8]) -> Option<DropReason> {
    reader.push(at(0), f.writer_name(), payload, &mut Received::default()).err()
}

/// Returns the end offsets of a payload's segments.
fn split_ends(payload: &[u8]) -> Vec<usize> {
    let mut ends = vec![];
    let mut at = 0;
    while at < payload.len() {
        at += HEADER_LEN + usize::from(u16::from_be_bytes([payload[at + 2], payload[at + 3]]));
        ends.push(at);
    }
    ends
}
