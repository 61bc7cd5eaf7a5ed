//! What an endpoint is created for.

use crate::key::{TypeHash, topic_key};
use crate::qos::Qos;

/// A topic or service with its type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Such as `/chatter`.
    pub name: String,
    /// The DDS type, such as `std_msgs::msg::dds_::String_`.
    pub kind: String,
    pub hash: TypeHash,
    pub qos: Qos,
}

impl Topic {
    pub(crate) fn key(&self, domain: u32) -> String {
        topic_key(domain, &self.name, &self.kind, &self.hash)
    }
}
