//! A message with its publisher.

use bytes::Bytes;
use std::sync::Arc;

/// A message with its publisher.
#[derive(Clone, Debug)]
pub struct Message {
    /// The message in ROS 1 serialization, without the length prefix.
    pub data: Bytes,
    pub publisher: Arc<PublisherInfo>,
}

/// The fields of a publisher's connection header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublisherInfo {
    /// The URI of its slave API.
    pub uri: String,
    /// The name of its node, or empty if the header lacks it.
    pub caller_id: String,
    /// The type, such as `std_msgs/String`.
    pub kind: String,
    pub md5sum: String,
    /// The definition with those of all nested types, or empty if the header lacks it.
    pub definition: String,
    /// Whether the publisher latches. Then the first message on a connection may be old.
    pub latching: bool,
}
