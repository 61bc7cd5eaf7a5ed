//! What readers and writers tell each other, before and after it is opened.

use std::sync::OnceLock;

use gdp_core::identity::Identity;
use gdp_e2e::feedback_wire::{Feedback, MAX_FEEDBACK};
use gdp_e2e::keys::PairKey;

/// Bytes that are taken for feedback are its only encoding, and come through a sealed channel once;
/// bytes that nobody sealed do not.
pub fn feedback(data: &[u8]) {
    let (own, peer) = keys();
    let mut opener = peer.opener();
    assert!(opener.open(data).is_err(), "nobody sealed this");
    let Ok(feedback) = Feedback::decode_all(data) else { return };
    let mut again = Vec::new();
    for message in &feedback {
        message.encode(&mut again).expect("what was decoded");
    }
    assert!(again == data);
    if data.len() > MAX_FEEDBACK {
        return;
    }
    let mut sealed = Vec::new();
    own.sealer().expect("randomness").seal(&feedback, &mut sealed).expect("what was decoded");
    assert_eq!(opener.open(&sealed), Ok(feedback));
    assert!(opener.open(&sealed).is_err(), "taken twice");
}

/// Of two that talk to each other.
fn keys() -> &'static (PairKey, PairKey) {
    static KEYS: OnceLock<(PairKey, PairKey)> = OnceLock::new();
    KEYS.get_or_init(|| {
        let [a, b] = ["robot", "cloud"].map(|kind| Identity::generate(kind).expect("an identity"));
        let pair = |own: &Identity, peer: &Identity| {
            PairKey::new((own.name(), own.box_key()), (peer.name(), &peer.box_public())).expect("box keys")
        };
        (pair(&a, &b), pair(&b, &a))
    })
}
