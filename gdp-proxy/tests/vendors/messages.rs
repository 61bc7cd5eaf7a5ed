//! The topic of the programs in `tests/peers`, and its messages.

use bytes::Bytes;
use gdp_proxy::ros2::{RawSample, RawWriter, TopicName, TypeName};

use crate::peer::within;

pub async fn write(writer: &mut RawWriter, sequence: i64, size: usize) {
    let sample = message(sequence, size);
    // The sockets of a busy machine hold the writer back.
    within("room for a message", async { while writer.write(sample.clone(), 0).await.is_err() {} }).await;
}

/// A message as the programs write and check it (`tests/peers/README.md`).
pub fn message(sequence: i64, size: usize) -> RawSample {
    let filler = "x".repeat(size - 43);
    let text = format!("{sequence:010} {:020} {:010} {filler}\0", 0, crc32fast::hash(filler.as_bytes()));
    cdr(&[&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat())
}

pub fn cdr(body: &[u8]) -> RawSample {
    RawSample::parse(Bytes::from([&[0, 1, 0, 0], body].concat())).unwrap()
}

pub fn topic() -> TopicName {
    TopicName::parse("/chatter").unwrap()
}

pub fn string() -> TypeName {
    TypeName::parse("std_msgs/msg/String").unwrap()
}
