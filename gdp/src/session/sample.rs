//! A received message.

use std::str::Utf8Error;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use gdp_e2e::seal::{Encoding, Message};
use gdp_wire::Name;

/// A received message. Its signature is verified: the source did send it, and had the right to.
#[derive(Clone, Debug)]
pub struct Sample {
    topic: Arc<str>,
    message: Message,
}

impl Sample {
    pub(super) fn new(topic: Arc<str>, message: Message) -> Self {
        Self { topic, message }
    }

    /// Returns the topic or service as the program named it.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Returns the content.
    pub fn payload(&self) -> &Bytes {
        &self.message.body
    }

    /// Returns the content, without a copy.
    pub fn into_payload(self) -> Bytes {
        self.message.body
    }

    /// Returns the content as text.
    ///
    /// # Errors
    ///
    /// Fails if it is not UTF-8.
    pub fn text(&self) -> Result<&str, Utf8Error> {
        std::str::from_utf8(&self.message.body)
    }

    /// Returns the encoding that the source states.
    pub fn encoding(&self) -> Encoding {
        self.message.encoding
    }

    /// Returns the entity that sent it.
    pub fn source(&self) -> Name {
        self.message.writer
    }

    /// Returns its number. The numbers of a source rise until it starts again.
    pub fn sequence(&self) -> u64 {
        self.message.sequence
    }

    /// Returns when it was sent, by the source's clock.
    pub fn time(&self) -> SystemTime {
        let sent = self.message.latched.map_or(self.message.timestamp_ns, |first| first.timestamp_ns);
        SystemTime::UNIX_EPOCH + Duration::from_nanos(sent)
    }

    /// Returns whether it was sent before, and is repeated for readers that joined later.
    pub fn is_latched(&self) -> bool {
        self.message.latched.is_some()
    }

    /// Returns the message of the low-level node.
    #[doc(hidden)]
    pub fn into_message(self) -> Message {
        self.message
    }
}
