//! Messages on a link's control streams.

use gdp_proto::control::{Request, Response, decode, encode};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// What is decoded is bounded, and encodes to what decodes to the same.
pub fn control(data: &[u8]) {
    round_trip::<Request>(data);
    round_trip::<Response>(data);
}

fn round_trip<T: Serialize + DeserializeOwned>(data: &[u8]) {
    let Ok(message) = decode::<T>(data) else { return };
    // A message may be encoded in more than one way, and ours be longer.
    let Ok(bytes) = encode(&message) else { return };
    let again: T = decode(&bytes[4..]).expect("what was encoded here");
    assert_eq!(encode(&again).expect("as long as before"), bytes);
}
