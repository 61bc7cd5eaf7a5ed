//! Unit tests of `feedback_wire`.

use super::*;

const NAME: Name = Name::from_bytes([7; 32]);
const SESSION: [u8; 16] = [9; 16];

#[test]
fn every_kind_survives_its_bytes() {
    for (feedback, len) in all() {
        let bytes = encoded(&feedback);
        assert_eq!(bytes.len(), len, "{feedback:?}");
        assert_eq!(feedback.encoded_len(), len);
        assert_eq!(Feedback::decode_all(&bytes), Ok(vec![feedback.clone()]));
        assert_eq!(feedback.name(), NAME);
    }
    assert_eq!(encoded(&nack((1..=MAX_MISSING as u64).map(Missing::whole).collect())).len(), MAX_FEEDBACK);
}

#[test]
fn fields_are_where_the_specification_says() {
    let bytes = encoded(&nack(vec![Missing { sequence: 0x0102_0304_0506, cut: 7, first: 8, count: 9 }]));
    assert_eq!(hex::encode(&bytes[..2]), "0407");
    let fields = "09 000000000000000a 0000000b 0000000c 01 010203040506 0007 00000008 00000009";
    assert_eq!(hex::encode(&bytes[48..]), fields.replace(' ', ""));
    let (report, _) = &all()[2];
    let expected = "0000000000000005 0000000000000004 0000000000000006 0000000000000007 000000000000000c 00000008 0000000000000009 \
                    0000000a 0000000b";
    assert_eq!(hex::encode(&encoded(report)[49..]), expected.replace(' ', ""));
}

#[test]
fn a_held_key_has_the_length_that_it_states() {
    let held = |len| Feedback::NewestKey { name: NAME, key_box: Signed::from_bytes(vec![5; len]).unwrap() };
    for len in [0, 1, MAX_KEY_BOX] {
        let mut bytes = encoded(&held(len));
        assert_eq!(bytes.len(), 35 + len);
        assert!(bytes.len() <= MAX_FEEDBACK);
        assert_eq!(Feedback::decode_all(&bytes), Ok(vec![held(len)]));
        for shorter in 0..bytes.len() {
            assert!(Feedback::decode_all(&bytes[..shorter]).is_err(), "{shorter} of {len}");
        }
        bytes.push(0);
        assert_eq!(Feedback::decode_all(&bytes), Err(FeedbackError::Kind(0)));
    }
    let mut out = Vec::new();
    assert_eq!(held(MAX_KEY_BOX + 1).encode(&mut out), Err(FeedbackError::KeyBox(MAX_KEY_BOX + 1)));
    let too_long = [&[8][..], NAME.as_bytes(), &769_u16.to_be_bytes(), &[5; 769]].concat();
    assert_eq!(Feedback::decode_all(&too_long), Err(FeedbackError::KeyBox(769)));
}

#[test]
fn other_lengths_and_kinds_are_refused() {
    for (feedback, _) in all() {
        let mut bytes = encoded(&feedback);
        for len in 0..bytes.len() {
            assert!(Feedback::decode_all(&bytes[..len]).is_err(), "{len} bytes of {feedback:?}");
        }
        bytes.push(0);
        assert_eq!(Feedback::decode_all(&bytes), Err(FeedbackError::Kind(0)));
        for kind in [0, 9, 0xff] {
            bytes[0] = kind;
            assert_eq!(Feedback::decode_all(&bytes), Err(FeedbackError::Kind(kind)));
        }
    }
}

#[test]
fn a_nack_asks_for_each_segment_once() {
    let range = |sequence, first, count| Missing { sequence, cut: 1, first, count };
    let refused = |missing: Vec<Missing>| {
        let (feedback, mut out) = (nack(missing), Vec::new());
        let error = feedback.encode(&mut out).unwrap_err();
        assert!(out.is_empty());
        error
    };
    for missing in [
        vec![range(1, 0, 0)],
        vec![range(1, 2, u32::MAX)],
        vec![range(2, 0, 1), range(1, 0, 1)],
        vec![range(1, 0, 1), range(1, 0, 1)],
        vec![range(1, 0, 3), range(1, 2, 1)],
        vec![Missing::whole(1), range(1, 5, 1)],
    ] {
        assert_eq!(refused(missing.clone()), FeedbackError::Order, "{missing:?}");
    }
    assert_eq!(refused(vec![]), FeedbackError::Ranges(0));
    assert_eq!(refused((1..=63).map(Missing::whole).collect()), FeedbackError::Ranges(63));
    assert_eq!(refused(vec![Missing::whole(1 << 48)]), FeedbackError::Sequence(1 << 48));
    encoded(&nack(vec![range(1, 0, 3), range(1, 3, 1), range(2, 0, 1), range(3, u32::MAX, 1)]));
}

/// Encodings that only an attacker produces, because `encode` refuses them.
#[test]
fn hostile_bytes_are_refused() {
    let two = encoded(&nack(vec![Missing::whole(1), Missing::whole(2)]));
    let twice = [&two[..NACK_LEN + MISSING_LEN], &two[NACK_LEN..NACK_LEN + MISSING_LEN]].concat();
    assert_eq!(Feedback::decode_all(&twice), Err(FeedbackError::Order));
    for count in [0, 63, 255] {
        let mut bytes = two.clone();
        bytes[NACK_LEN - 1] = count;
        assert_eq!(Feedback::decode_all(&bytes), Err(FeedbackError::Ranges(count.into())));
    }
    let (welcome, _) = &all()[1];
    let mut bytes = encoded(welcome);
    bytes[WELCOME_LEN - 12] = 1;
    assert!(matches!(Feedback::decode_all(&bytes), Err(FeedbackError::Sequence(_))));
    let (hello, _) = &all()[0];
    let mut bytes = encoded(hello);
    bytes[HELLO_LEN - 1] = 3;
    assert_eq!(Feedback::decode_all(&bytes), Err(FeedbackError::Flag(3)));
}

#[test]
fn messages_follow_one_another() {
    let both: Vec<_> = all().into_iter().map(|(feedback, _)| feedback).collect();
    let mut bytes = both.iter().flat_map(encoded).collect::<Vec<_>>();
    assert_eq!(Feedback::decode_all(&bytes), Ok(both));
    bytes.pop();
    assert!(matches!(Feedback::decode_all(&bytes), Err(FeedbackError::Length { .. })), "none is truncated");
    assert!(Feedback::decode_all(&[]).is_err(), "there is at least one");
}

fn all() -> [(Feedback, usize); 7] {
    let (name, session, challenge) = (NAME, SESSION, [3; 16]);
    let report = Feedback::Report {
        name,
        session,
        highest: 5,
        acknowledged: 4,
        received_segments: 6,
        received_bytes: 7,
        needless_bytes: 12,
        ce: 8,
        echo: 9,
        echo_index: 10,
        delay_us: 11,
    };
    [
        (Feedback::Hello { name, challenge, wants: Wants::Offered }, 50),
        (Feedback::Welcome { name, challenge, session, sequence: MAX_SEQUENCE, history: 0 }, 77),
        (report, 109),
        (Feedback::Unavailable { name, session, oldest: 12 }, 57),
        (Feedback::Clock { name, session, challenge: [8; 16], unix_ns: u64::MAX }, 73),
        (Feedback::ClockAnswer { name, challenge: [8; 16], unix_ns: 13 }, 57),
        (nack(vec![Missing::whole(4), Missing { sequence: 5, cut: 1, first: 2, count: 3 }]), 66 + 2 * 16),
    ]
}

fn nack(missing: Vec<Missing>) -> Feedback {
    Feedback::Nack { name: NAME, session: SESSION, highest: 0x0a, highest_index: 0x0b, waited_us: 0x0c, missing }
}

fn encoded(feedback: &Feedback) -> Vec<u8> {
    let mut bytes = Vec::new();
    feedback.encode(&mut bytes).unwrap();
    bytes
}
