//! Unit tests of `keys::pair`.

use super::*;
use crate::feedback_wire::{MAX_MISSING, Missing, Wants};
use gdp_core::identity::{Identity, SigningKey};
use gdp_faults::Random;

#[test]
fn two_understand_each_other_and_nobody_else_does() {
    let [a, b, c] = [1, 2, 3].map(identity);
    let (mut to_b, mut from_a) = (pair(&a, &b).sealer().unwrap(), pair(&b, &a).opener());
    for i in 0..100 {
        assert_eq!(from_a.open(&sealed(&mut to_b, i)), Ok(vec![hello(i)]));
    }
    let payload = sealed(&mut to_b, 7);
    for (who, mut opener) in [
        ("the sender itself", pair(&a, &b).opener()),
        ("another pair of the receiver", pair(&b, &c).opener()),
        ("a third", pair(&c, &a).opener()),
    ] {
        assert_eq!(opener.open(&payload), Err(PairError::Forged), "{who}");
        assert!(opener.sessions.is_empty());
    }
    // Two entities with the same box key are distinct from one entity with itself.
    let twin = Identity::new(a.key().clone(), "switch");
    assert_eq!(pair(&twin, &b).opener().open(&payload), Err(PairError::Forged));
}

#[test]
fn each_message_is_taken_once_in_any_order() {
    let (mut sealer, mut opener) = channel();
    let mut random = Random::new(3);
    let mut payloads: Vec<_> = (0..200).map(|i| (i, sealed(&mut sealer, i))).collect();
    random.shuffle(&mut payloads);
    for (i, payload) in &payloads {
        assert_eq!(opener.open(payload), Ok(vec![hello(*i)]));
    }
    for (_, payload) in &payloads {
        assert_eq!(opener.open(payload), Err(PairError::Replayed));
    }
    let old = sealed(&mut sealer, 1);
    for i in 0..1024 {
        opener.open(&sealed(&mut sealer, i as u8)).unwrap();
    }
    assert_eq!(opener.open(&old), Err(PairError::Replayed), "too late");
}

#[test]
fn a_restarted_peer_is_understood_and_what_it_said_before_is_not_taken_again() {
    let [a, b] = [1, 2].map(identity);
    let mut opener = pair(&b, &a).opener();
    let mut recorded = Vec::new();
    for _ in 0..SESSIONS + RETIRED {
        let mut sealer = pair(&a, &b).sealer().unwrap();
        for i in 0..2 {
            let payload = sealed(&mut sealer, i);
            assert_eq!(opener.open(&payload), Ok(vec![hello(i)]));
            recorded.push(payload);
        }
    }
    for payload in &recorded {
        assert_eq!(opener.open(payload), Err(PairError::Replayed));
    }
    assert_eq!((opener.sessions.len(), opener.retired.len()), (SESSIONS, RETIRED));
}

#[test]
fn memory_is_bounded_and_the_living_session_stays() {
    let [a, b] = [1, 2].map(identity);
    let mut opener = pair(&b, &a).opener();
    let mut living = pair(&a, &b).sealer().unwrap();
    for _ in 0..1000 {
        opener.open(&sealed(&mut living, 1)).unwrap();
        for _ in 0..SESSIONS - 1 {
            opener.open(&sealed(&mut pair(&a, &b).sealer().unwrap(), 2)).unwrap();
        }
        // Forgeries in their own sessions, and in one that is about to be dropped.
        let mut forged = sealed(&mut pair(&a, &b).sealer().unwrap(), 2);
        forged[HEADER_LEN] ^= 1;
        assert_eq!(opener.open(&forged), Err(PairError::Forged));
    }
    assert_eq!((opener.sessions.len(), opener.retired.len()), (SESSIONS, RETIRED));
}

#[test]
fn hostile_payloads_are_refused_and_change_nothing() {
    let (mut sealer, mut opener) = channel();
    opener.open(&sealed(&mut sealer, 0)).unwrap();
    let payload = sealed(&mut sealer, 1);
    for at in 0..payload.len() {
        let mut changed = payload.clone();
        changed[at] ^= 0x40;
        assert!(opener.open(&changed).is_err(), "byte {at}");
        assert!(opener.open(&payload[..at]).is_err(), "cut to {at}");
    }
    assert_eq!(opener.open(&[VERSION; MAX_PAIR_PAYLOAD + 1]), Err(PairError::Length(MAX_PAIR_PAYLOAD + 1)));
    assert_eq!(opener.open(&[9; 60]), Err(PairError::Version(9)));
    // Even the highest counter advances no window unless the message opens.
    let mut ahead = payload.clone();
    ahead[9..17].fill(0xff);
    assert_eq!(opener.open(&ahead), Err(PairError::Forged));
    assert_eq!(opener.open(&payload), Ok(vec![hello(1)]));
}

#[test]
fn a_nonce_is_never_repeated() {
    let (mut sealer, mut opener) = channel();
    let bad =
        Feedback::Nack { name: name(1), session: [1; 16], highest: 0, highest_index: 0, waited_us: 0, missing: vec![] };
    let mut out = vec![1];
    assert_eq!(sealer.seal(&[bad], &mut out), Err(PairError::Feedback(FeedbackError::Ranges(0))));
    assert!(out.is_empty());
    let first = sealed(&mut sealer, 1);
    assert_eq!(first[9..17], 2u64.to_be_bytes());
    sealer.next = MESSAGES;
    let (last, next) = (sealed(&mut sealer, 2), sealed(&mut sealer, 3));
    assert_ne!(last[1..9], next[1..9], "another session");
    for (i, payload) in [first, last, next].iter().enumerate() {
        assert_eq!(opener.open(payload), Ok(vec![hello(i as u8 + 1)]));
    }
}

#[test]
fn the_largest_feedback_fits_the_smallest_link() {
    let (mut sealer, mut opener) = channel();
    let missing = (1..=MAX_MISSING as u64).map(Missing::whole).collect();
    let nack = Feedback::Nack { name: name(1), session: [1; 16], highest: 0, highest_index: 0, waited_us: 0, missing };
    let mut out = Vec::new();
    sealer.seal(std::slice::from_ref(&nack), &mut out).unwrap();
    assert_eq!(out.len(), MAX_PAIR_PAYLOAD);
    assert_eq!(opener.open(&out), Ok(vec![nack.clone()]));
    let more = [nack, hello(1)];
    assert_eq!(
        sealer.seal(&more, &mut out),
        Err(PairError::Length(HEADER_LEN + MAX_FEEDBACK + hello(1).encoded_len()))
    );
    assert_eq!(sealer.seal(&[], &mut out), Err(PairError::Length(HEADER_LEN)));
    // QUIC's smallest packet, 1200 bytes, minus the header of a frame.
    const { assert!(MAX_PAIR_PAYLOAD <= 1200 - 96) };
}

#[test]
fn nothing_prints_a_key() {
    let [a, b] = [1, 2].map(identity);
    let key = pair(&a, &b);
    let text = format!("{key:?} {:?} {:?}", key.sealer().unwrap(), key.opener());
    assert!(!text.contains(&hex::encode(&key.secret[..4])), "{text}");
    assert!(!text.contains(&format!("{}, {}, {}", key.secret[0], key.secret[1], key.secret[2])), "{text}");
}

fn channel() -> (PairSealer, PairOpener) {
    let [a, b] = [1, 2].map(identity);
    (pair(&a, &b).sealer().unwrap(), pair(&b, &a).opener())
}

fn pair(own: &Identity, peer: &Identity) -> PairKey {
    PairKey::new((own.name(), own.box_key()), (peer.name(), &peer.box_public())).unwrap()
}

fn sealed(sealer: &mut PairSealer, i: u8) -> Vec<u8> {
    let mut out = Vec::new();
    sealer.seal(&[hello(i)], &mut out).unwrap();
    out
}

fn hello(i: u8) -> Feedback {
    Feedback::Hello { name: name(1), challenge: [i; 16], wants: Wants::Newest }
}

fn identity(seed: u8) -> Identity {
    Identity::new(SigningKey::from_secret_bytes(&[seed; 32]).unwrap(), "proxy")
}

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}
