//! Recomputes `docs/vectors/keys.json` and compares it with the published file.

use serde_json::{Value, json};

use super::*;
use crate::feedback_wire::{Feedback, Missing, Wants};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::{EpochKey, KeyBox};
use gdp_core::name::Name;

const NAME: Name = Name::from_bytes([0x11; 32]);
const EPOCH: u32 = 1_800_000_000;

/// The key `0707…07`, sealed for the reader. Sealing is randomised, so the result is fixed here.
const SEALED: &str = "04e21961152aef035e17dedb495c4c82f9bb574e950690013564a6eea3f66c4560145ca2ada18c194f4ed18a33\
                      623081d53b8f565c1565b8a7a6565ec75251bc8c9af90acaa62a31801bc37128c6b567d86e6a0a226ddbc7655f\
                      ba9975d2398a1cefe78dcae4af6b0af24fb65e4518c77f";

#[test]
fn vectors_of_keys_and_feedback() {
    let [writer, reader] =
        [1, 2].map(|seed| Identity::new(SigningKey::from_secret_bytes(&[seed; 32]).unwrap(), "proxy"));
    let entity = |seed: u8, entity: &Identity| {
        json!({
            "signing_key": hex::encode([seed; 32]),
            "name": entity.name(),
            "box_public": hex::encode(entity.box_public()),
        })
    };
    let info = KeyBox { name: NAME, writer: writer.name(), reader: reader.name(), epoch: EPOCH, sealed: vec![] }.info();
    let sealed = hex::decode(SEALED).unwrap();
    let epoch_key = EpochKey::from_slice(&reader.box_key().open(&info, &sealed).unwrap()).unwrap();

    let pair = PairKey::new((reader.name(), reader.box_key()), (writer.name(), &writer.box_public())).unwrap();
    let back = PairKey::new((writer.name(), writer.box_key()), (reader.name(), &reader.box_public())).unwrap();
    let mut sealer = pair.sealer_in([0x55; 8]).unwrap();
    let mut opener = back.opener();
    let mut payload = |feedback: &[Feedback]| {
        let (mut clear, mut payload) = (Vec::new(), Vec::new());
        feedback.iter().for_each(|feedback| feedback.encode(&mut clear).unwrap());
        sealer.seal(feedback, &mut payload).unwrap();
        assert_eq!(opener.open(&payload).as_deref(), Ok(feedback));
        json!({ "plaintext": hex::encode(clear), "payload": hex::encode(payload) })
    };
    let (name, session, challenge) = (NAME, [0x33; 16], [0x44; 16]);
    let missing = vec![Missing { sequence: 5, cut: 1, first: 2, count: 3 }, Missing::whole(6)];
    let report = Feedback::Report {
        name,
        session,
        highest: 7,
        acknowledged: 6,
        received_segments: 40,
        received_bytes: 50_000,
        needless_bytes: 1_400,
        ce: 1,
        echo: 7,
        echo_index: 3,
        delay_us: 250,
    };
    let clock = |unix_ns| Feedback::Clock { name, session, challenge, unix_ns };
    let vectors = json!({
        "writer": entity(1, &writer),
        "reader": entity(2, &reader),
        "key_box": {
            "name": NAME,
            "epoch": EPOCH,
            "info": hex::encode(&info),
            "sealed": hex::encode(&sealed),
            "epoch_key": hex::encode(epoch_key.as_bytes()),
        },
        "feedback": {
            "from": "reader",
            "to": "writer",
            "session": hex::encode([0x55; 8]),
            "hello": payload(&[Feedback::Hello { name, challenge, wants: Wants::Every }]),
            "welcome": payload(&[Feedback::Welcome { name, challenge, session, sequence: 9, history: 1024 }]),
            "report": payload(std::slice::from_ref(&report)),
            "nack": payload(&[Feedback::Nack { name, session, highest: 7, highest_index: 3, waited_us: 12_000, missing }]),
            "gone": payload(&[Feedback::Unavailable { name, session, oldest: 8 }]),
            "clock": payload(&[clock(1_800_000_000_123_456_789)]),
            "clock_answer": payload(&[Feedback::ClockAnswer { name, challenge, unix_ns: 1_800_003_600_123_456_789 }]),
            "two": payload(&[report, Feedback::Unavailable { name, session, oldest: 8 }]),
        },
        "refused": { "plaintexts": refused_plaintexts(&clock(1)), "payloads": refused_payloads(&pair, &back, &clock(1)) },
    });
    crate::vectors::check("keys.json", &vectors);
}

/// Returns plaintexts of feedback that are no messages, with the reason.
fn refused_plaintexts(clock: &Feedback) -> Vec<Value> {
    let encoded = |feedback: &Feedback| {
        let mut bytes = Vec::new();
        feedback.encode(&mut bytes).unwrap();
        bytes
    };
    let changed = |mut bytes: Vec<u8>, at: usize, byte: u8| {
        bytes[at] = byte;
        bytes
    };
    let (name, session) = (NAME, [0x33; 16]);
    let hello = encoded(&Feedback::Hello { name, challenge: [0x44; 16], wants: Wants::Every });
    let gone = encoded(&Feedback::Unavailable { name, session, oldest: 8 });
    let missing = vec![Missing::whole(5), Missing::whole(6)];
    let nack = Feedback::Nack { name, session, highest: 7, highest_index: 3, waited_us: 0, missing };
    let nack = encoded(&nack);
    let clock = encoded(clock);
    let cases = [
        ("a kind that does not exist", changed(hello.clone(), 0, 99)),
        ("a Hello that wants what does not exist", changed(hello.clone(), hello.len() - 1, 3)),
        ("a Hello that is a byte short", hello[..hello.len() - 1].to_vec()),
        ("a message and a byte of the next", [&gone[..], &hello[..1]].concat()),
        ("a sequence of 49 bits", changed(gone.clone(), gone.len() - 7, 1)),
        ("a Nack whose second range is before its first", changed(nack.clone(), nack.len() - 11, 4)),
        ("a Nack that ends within a range", nack[..nack.len() - 1].to_vec()),
        ("a Clock that is a byte short", clock[..clock.len() - 1].to_vec()),
    ];
    let refused = cases.map(|(description, bytes)| {
        let reason = Feedback::decode_all(&bytes).expect_err(description).to_string();
        json!({ "description": description, "plaintext": hex::encode(&bytes), "refused": reason })
    });
    refused.to_vec()
}

/// Returns payloads that the writer's side refuses, with the reason. Each is the first of its
/// session, but for the one that comes again.
fn refused_payloads(from: &PairKey, to: &PairKey, clock: &Feedback) -> Vec<Value> {
    let mut good = Vec::new();
    from.sealer_in([0x56; 8]).unwrap().seal(std::slice::from_ref(clock), &mut good).unwrap();
    let changed = |at: usize| {
        let mut bytes = good.clone();
        bytes[at] ^= 1;
        vec![bytes]
    };
    let mut own = Vec::new();
    to.sealer_in([0x57; 8]).unwrap().seal(std::slice::from_ref(clock), &mut own).unwrap();
    let cases = [
        ("another version", changed(0)),
        ("another session", changed(1)),
        ("another counter", changed(16)),
        ("a changed byte of the ciphertext", changed(20)),
        ("a changed tag", changed(good.len() - 1)),
        ("a payload that ends within the tag", vec![good[..32].to_vec()]),
        ("what the writer itself has sealed", vec![own]),
        ("the same payload again", vec![good.clone(), good.clone()]),
    ];
    let refused = cases.map(|(description, payloads)| {
        let mut opener = to.opener();
        let results: Vec<_> = payloads.iter().map(|payload| opener.open(payload)).collect();
        let (last, before) = results.split_last().unwrap();
        assert!(before.iter().all(Result::is_ok), "{description}: {before:?}");
        let reason = last.as_ref().expect_err(description).to_string();
        let payloads = payloads.iter().map(hex::encode).collect::<Vec<_>>();
        json!({ "description": description, "payloads": payloads, "refused": reason })
    });
    refused.to_vec()
}
