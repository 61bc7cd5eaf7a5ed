//! Recomputes `docs/vectors/keys.json` and compares it with the published file.

use serde_json::json;

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
            "two": payload(&[report, Feedback::Unavailable { name, session, oldest: 8 }]),
        },
    });
    crate::vectors::check("keys.json", &vectors);
}
