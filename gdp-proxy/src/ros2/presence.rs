//! The channel between the proxies of a DDS domain: a CDR string on a topic outside of ROS.

use super::{RawReader, RawSample, RawWriter, Representation};
use crate::peer_proxies::Voice;

pub struct Presence {
    pub writer: RawWriter,
    pub reader: RawReader,
}

impl Voice for Presence {
    async fn tell(&mut self, text: String) {
        if let Err(error) = self.writer.write(written(&text), 0).await {
            tracing::debug!("other proxies in the domain were not told: {error}");
        }
    }

    async fn hear(&mut self) -> Option<Vec<u8>> {
        Some(self.reader.recv().await.map_or_else(|_| vec![], |arrived| read(&arrived.sample)))
    }
}

fn written(text: &str) -> RawSample {
    let length = text.len() as u32 + 1;
    let bytes = [&[0, 1, 0, 0], &length.to_le_bytes()[..], text.as_bytes(), &[0]].concat();
    RawSample { representation: Representation::CdrLe, bytes: bytes.into() }
}

/// Returns the text of a CDR string, or nothing if the sample is none.
fn read(sample: &RawSample) -> Vec<u8> {
    let [_, _, _, _, a, b, c, d, text @ ..] = &sample.bytes[..] else { return vec![] };
    let length = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
    text.get(..length.saturating_sub(1)).unwrap_or_default().to_vec()
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/presence.rs"]
mod tests;
